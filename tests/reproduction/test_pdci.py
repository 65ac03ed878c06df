"""The Pacific DC Intertie: delay within a frame, loads of converters; controllers are judged where none was tuned."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case import tuned as laws
from facts_damping_reproduction.pdci import study, tuned
from facts_damping_studies.margins.linear_closed_loop import link_delays

if TYPE_CHECKING:
    from pathlib import Path

PLACES = ("bus", "line", "machine", "load")


def places(case: dict[str, object]) -> set[str]:
    """Where the events of a case are."""
    events = study.made({"scenario": case["scenario"]}).scenario.events
    return {str(getattr(event, name)) for event in events for name in PLACES if getattr(event, name, None)}


def test_held_out_cases_share_no_place_and_no_draw_with_training() -> None:
    known, held = ([case["set"] for case in tuned.cases(which)] for which in ("training", "held_out"))
    assert not set[str]().union(*map(places, known)) & set[str]().union(*map(places, held))
    assert len(held) >= 24
    for drawn in ("seed", "link.up.1.delay", "system.loads.0.P"):
        assert not {case_sets[drawn] for case_sets in known} & {case_sets[drawn] for case_sets in held}
    assert len({case_sets["seed"] for case_sets in held}) == len(held)


def test_phase_of_the_delay_within_a_frame_moves_a_mode_of_exact_frequencies() -> None:
    """100 ms are six frames at 60 frames/s; 116.66 ms are nearly seven."""
    looped, name = study.Looped("ideal", 10, {}), "north-south B"
    interval = study.interval([looped.modes(0.1, phase) for phase in (0, 0.5, 0.9999)])
    six, seven = (looped.modes(delay)[name] for delay in (0.11666, 0.11667))
    low, high = interval[f"{name}, min"], interval[f"{name}, max"]
    assert (low, high, interval[name]) == pytest.approx((0.166, 0.189, high), abs=5e-4)
    assert six == pytest.approx(low, abs=2e-4)
    assert seven == pytest.approx(0.183, abs=5e-4)


def test_pmus_of_p_class_do_not_see_the_step_and_count_in_the_delay() -> None:
    looped = study.Looped("p_class", 10, {})
    six, seven = (looped.modes(0.1, phase)["north-south B"] for phase in (0.9999, 1.0001))
    assert six == pytest.approx(seven, abs=1e-4)
    assert looped.modes(0.1)["north-south B"] == pytest.approx(0.181, abs=5e-4)
    linked = study.made(study.linked("p_class", 0.1))
    assert link_delays(linked) == pytest.approx([5 / 60], abs=2e-9)


def test_constant_power_of_the_dc_lines_moves_the_modes_from_where_conductance_has_them() -> None:
    power, conductance = (study.free(study.schedule(kind)) for kind in ("power", "impedance"))
    assert power["north-south A"] - conductance["north-south A"] == pytest.approx(0.0037, abs=2e-4)
    assert power["north-south B"] < conductance["north-south B"]
    assert study.per_power("conductance") == pytest.approx(1.058, abs=1e-3)


def test_file_of_what_a_search_found_is_taken_by_a_run(tmp_path: Path) -> None:
    space = tuned._space("LLC-tuned")
    rows = space.rows(np.full(space.size, 0.5))
    file = tuned.laws({"searches": {("LLC-tuned", 2): {"rows": rows, "value": -0.25, "loops": 960}}}, tmp_path)
    assert [name for name, _ in laws.rows("pdci", laws.read(file))] == ["LLC-tuned@pdci.2"]
    plain = [{"name": "LLC-tuned", "devices": ["pdci"], "signals": ["hertz"]}]
    case = study.made({"tuning": str(file), "controllers": plain})
    assert {**case.controllers[0].parameters, **rows[0]["parameters"]} == case.controllers[0].parameters
