"""The shipped ensembles: every draw can be run, noise is behind every link, and is in no figure but through control."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case, load_system
from facts_damping.parameters.files import shipped
from facts_damping.signals import CHANNELS
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_plant
from facts_damping_studies.sweeps import sweep
from facts_damping_studies.sweeps.batch import make, one_run

if TYPE_CHECKING:
    from facts_damping.case.model import Case

ENSEMBLES = [name for name in shipped("studies") if name.startswith("ensemble_")]
SYSTEMS = ("smib", "two_area")


def test_there_is_one_a_scenario() -> None:
    """Of both systems of the thesis."""
    wanted = [name.replace("/", "_") for name in shipped("scenarios") if name.split("/")[0] in SYSTEMS]
    assert sorted(f"ensemble_{name}" for name in wanted) == ENSEMBLES


@cache
def drawn(name: str) -> tuple[list[dict[str, Any]], list[Case]]:
    """What is drawn, and the cases."""
    plan = sweep.plan(name, [])
    return [point.columns for point in plan.points], [make(plan.base, point.changes) for point in plan.points]


@pytest.mark.parametrize("name", ENSEMBLES)
def test_ensemble_draws_start_from_distinct_equilibria(name: str) -> None:
    """Also the limits of all controls admit it: the plant can be built. No two draws are alike in anything.

    Built are the draws with the least and the largest value of anything, and some others.
    """
    columns, cases = drawn(name)
    assert len(cases) == (8 if name.endswith("training") else 100)
    built = set(range(0, len(cases), 10))
    for column in columns[0]:
        values = [row[column] for row in columns]
        assert len(set(values)) == len(cases), column
        built |= {values.index(min(values)), values.index(max(values))}
    starts = {build_plant(cases[i]).state.x.tobytes() for i in built}
    assert len(starts) == len(built)
    rated = {m.name: m.rating for m in load_system(name.removeprefix("ensemble_").rpartition("_")[0]).machines}
    for case in cases:
        assert all((m.P or 0.0) < 1.001 * rated[m.name] for m in case.system.machines)


@pytest.mark.parametrize("name", ENSEMBLES)
def test_ensemble_holds_the_scenario_that_it_is_named_after(name: str) -> None:
    """Each number of its events and each dispatched power lies within what is drawn; the kinds are the same."""
    system, _, scenario = name.removeprefix("ensemble_").rpartition("_")
    nominal, (_, cases) = load_case(None, [f"system={system}", f"scenario={scenario}"]), drawn(name)
    assert all(case.duration == nominal.duration and len(case.run.controllers) == 1 for case in cases)
    for i, event in enumerate(nominal.scenario.events):
        for field, value in event.model_dump().items():
            field_values = [case.scenario.events[i].model_dump()[field] for case in cases]
            if not isinstance(value, float):
                assert set(field_values) == {value}
            elif len(set(field_values)) > 1 and field != "location":  # places are drawn along a whole line
                assert min(field_values) < value < max(field_values)
            elif len(set(field_values)) == 1:
                assert field_values[0] == value
    for m, power in enumerate(machine.P for machine in nominal.system.machines):
        if power is not None:
            powers = [float(case.system.machines[m].P or 0.0) for case in cases]
            assert min(powers) < power <= 1.001 * max(powers)


@pytest.mark.parametrize("link", ["ideal", "delay_100ms", "pdci_100ms"])
@pytest.mark.parametrize("name", ["ensemble_two_area_small", "ensemble_smib_heavy"])
def test_noise_is_behind_any_link(name: str, link: str) -> None:
    plan = sweep.plan(name, [f"link={link}"])
    preset = load_case(None, [f"link={link}"]).link
    for point in plan.points[:5]:
        case = make(plan.base, point.changes)
        assert (case.link.up[:-1], case.link.down) == (preset.up, preset.down)
        noise = case.link.up[-1].model_dump()
        assert (noise["model"], noise["measurement"], noise["channels"]) == ("noise", "speed_deviation", None)
        assert noise["std"] == point.columns["noise_std_pu"]
        assert 1e-7 <= noise["std"] <= 1e-5
        assert case.run.seed == point.columns["seed"]


def test_row_names_the_link_that_noise_was_put_behind() -> None:
    plan = sweep.plan("ensemble_two_area_small", ["link=pdci_100ms", "duration=2"])
    row = one_run(plan.base, sweep._tasks(plan, {})[0])[1]
    cells = [row.cells[name] for name in ("link", "scenario", "controller", "error")]
    assert cells == ["pdci_100ms", "small", "LLC", None]


def test_measured_speeds_are_noisy_for_controllers_alone() -> None:
    """Without a controller the record's frames are those of a run without noise; what arrives differs by its std."""
    noise = "link.up.+={model: noise, measurement: speed_deviation, std: 1e-5}"
    plain, noisy = (loop.run(load_case(None, ["controllers=[]", "duration=5", *more])) for more in ([], [noise]))
    assert noisy.frames.tobytes() == plain.frames.tobytes()
    error = (noisy.delivered["values"] - plain.delivered["values"])[plain.delivered["pmu"] < 4]  # at machines
    assert np.flatnonzero(np.nan_to_num(error).any(axis=0)).tolist() == [list(CHANNELS).index("speed_deviation")]
    speed_error = error[:, list(CHANNELS).index("speed_deviation")]
    assert speed_error.std() == pytest.approx(1e-5, rel=4.0 / np.sqrt(2.0 * len(speed_error)))
