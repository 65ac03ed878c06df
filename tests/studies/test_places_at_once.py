"""Effects of devices at all places at once, against each device installed at its place."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from facts_damping.case.loading import read_system
from facts_damping_studies.design import at_once, design, places
from tests.two_plants import path

# Largest error relative to the largest effect of the kind on a mode. Devices without a law of their own act as they
# are; a TCSC's reactance changes the power flow, a STATCOM the modes' shapes.
LARGEST = {"sssc": 0.02, "statcom": 0.2, "load_modulation": 1e-6, "bess": 1e-6, "exciter_input": 1e-6, "tcsc": 0.2}
SYSTEMS = ("two_area", "kundur_12_6_thyristor")


class Compared(NamedTuple):
    """Controllability by all at once and one by one, (modes, places)."""

    at_once: at_once.Effect
    one_by_one: list[places.Tried]
    exact: np.ndarray


@cache
def compared(name: str, kind: str, every: int = 1) -> Compared:
    grid = read_system(name)
    modes, _ = design.listed_modes(design.Task(name, [], 0.1, 0.1), grid)
    system = places.only(places.with_signals(grid, modes), [], grid)
    new = [place for place in places.places(grid, [kind]) if not place.own][::every]
    effect = at_once.effects(system, [place.device for place in new], modes)
    tried = [places.tried(places.Trial(system, place, modes)) for place in new]
    return Compared(effect, tried, np.array([attempt.controllability for attempt in tried]).T)


def errors(result: Compared) -> np.ndarray:
    """Largest error of each mode relative to the largest effect."""
    scale = np.nanmax(np.abs(result.exact), axis=1)
    return np.asarray(np.nanmax(np.abs(result.at_once.controllability - result.exact), axis=1) / scale)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("kind", LARGEST)
def test_effects_at_once_are_those_one_by_one(name: str, kind: str) -> None:
    result = compared(name, kind)
    assert result.exact.shape[1] > 1
    assert np.isfinite(result.exact).any(axis=0).all()
    assert (errors(result) < LARGEST[kind]).all()


@pytest.mark.parametrize("kind", ["sssc", "statcom"])
def test_effects_at_once_in_a_grid_of_122_buses(kind: str) -> None:
    result = compared("minniwecc", kind, 12)
    assert (errors(result) < LARGEST[kind]).all()


def test_effects_at_once_of_inverter_inputs() -> None:
    """Setpoints change neither power flow nor modes: to the error of the differences."""
    result = compared(path("solar"), "inverter_input")
    assert (errors(result) < 1e-5).all()


def test_effects_at_once_name_why_a_device_is_impossible() -> None:
    """As the device that is installed, but for what it changes of the power flow."""
    grid = read_system("two_area")
    modes, _ = design.listed_modes(design.Task("two_area", [], 0.1, 0.1), grid)
    new = next(place for place in places.places(grid, ["sssc"]) if not place.own)
    blocked = new._replace(
        device=new.device.model_copy(update={"I_min": 0.99999, "I_rated": 0.5, "enforce_rating": True})
    )
    effect = at_once.effects(grid, [blocked.device], modes)
    why_not = places.tried(places.Trial(places.only(grid, [], grid), blocked, modes)).why_not
    assert why_not.endswith("allowed: with enforce_rating at most I_rated, 0.5")
    assert effect.why_not[0].partition(";")[2] == why_not.partition(";")[2]
    assert np.isnan(effect.controllability).all()


def test_effects_at_once_with_a_response_time_and_a_dead_time() -> None:
    grid = read_system("two_area")
    modes, _ = design.listed_modes(design.Task("two_area", [], 0.1, 0.1), grid)
    system = places.only(grid, [], grid)
    late = [
        place._replace(device=place.device.model_copy(update={"response_time": 0.2, "dead_time": 0.05}))
        for place in places.places(grid, ["load_modulation"])
        if not place.own
    ]
    effect = at_once.effects(system, [place.device for place in late], modes)
    exact = np.array([places.tried(places.Trial(system, place, modes)).controllability for place in late]).T
    assert effect.controllability == pytest.approx(exact, rel=1e-5)


def test_ranked_places_near_the_top_are_exact() -> None:
    """Analyses of the ranking, against those with the device installed and all eigenvectors."""
    task = design.Task("two_area", [], 0.1, 0.1, kinds=("sssc", "statcom", "exciter_input"))
    ranking = design.ranked(task, 1, lambda _study, _what: lambda _done, _of: None)
    assert [pair.tried for pair in ranking.pairs]
    for pair in ranking.pairs:
        attempt = ranking.tried[pair.tried]
        narrow = places.only(ranking.system, [pair.signal], ranking.bare)
        exact = places.tried(places.Trial(narrow, attempt.place, ranking.modes))
        assert pair.residue == pytest.approx(
            exact.residue[ranking.target, list(narrow.signals).index(pair.signal)], rel=1e-5
        )
