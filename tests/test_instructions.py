"""The work of a run: instructions of a tick, and of an evaluation of the plant's slopes on larger grids.

A change by a tenth fails: more is a loss, less is to be written here.
"""

from __future__ import annotations

import pytest

from facts_damping.case.loading import load_case
from facts_damping.plant.dynamics import derivatives
from facts_damping.simulation.loop import build_loop
from facts_damping.simulation.tick import Loop, run_half_ticks
from tests.instructions import COUNTS, instructions

pytestmark = pytest.mark.skipif(not COUNTS, reason="counts are those of Linux on x86-64")
TICKS = 90  # before that which is counted; no event in them
TICK = {"two_area_deployment": 223_502}
EVALUATION = {"nets_nyps_two_devices": 40_916, "minniwecc": 144_743}


def begun(run: str) -> Loop:
    loop = build_loop(load_case(run, ["duration=2", "scenario=[]"]))
    run_half_ticks(loop, 0, 2 * TICKS)
    return loop


def test_instructions_stop_at_the_end_of_a_call() -> None:
    loop = begun("two_area_small")
    assert instructions(run_half_ticks, loop, 2 * TICKS, 2 * TICKS) < 500


@pytest.mark.parametrize("run", TICK)
def test_tick_takes_its_instructions(run: str) -> None:
    count = instructions(run_half_ticks, begun(run), 2 * TICKS, 2 * TICKS + 2)
    assert count == pytest.approx(TICK[run], rel=0.1)


@pytest.mark.parametrize("run", EVALUATION)
def test_evaluation_takes_its_instructions(run: str) -> None:
    loop = begun(run)
    plant, state, work = loop.measured.plant, loop.measured.plant_state, loop.measured.work
    arguments = plant, state.x, state.reference, state.source, 0, work.slopes[0], work
    assert instructions(derivatives, *arguments) == pytest.approx(EVALUATION[run], rel=0.1)
