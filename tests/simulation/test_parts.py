"""Parts of loops that are used again: a run has the same bits as one whose parts are all new."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.digest import digest
from facts_damping.simulation import loop, parts

LOAD_STEP = "scenario=[{time: 0.1, kind: load_step, load: load_1, change: 0.1}]"
GAMMA = "link.up=[{stage: network, model: gamma, delay: 0.05, shape: 2, scale: 0.01}]"
ANY = ("seed=7", "seed=8", "duration=0.6", LOAD_STEP, "system.step=0.002", "frame_rate=30", GAMMA, "seed=7")
NOISE = "measurement.noise.angle=0.001"
RUNS = {
    "two_area_deployment": ("arm_at=0.1", NOISE, "controllers=[]", "system.loads.0.P=960"),
    "two_area_decentralised": (
        "controllers.0.faults=[{kind: dead, start: 0.1, duration: 0.1}]",
        "controllers.1.parameters.momentum=0.3",
        "system.devices.0.setpoint_max=0.01",
    ),
    "smib_supervised": (NOISE, "supervision.authority.fraction=0.5"),
}


@pytest.mark.parametrize("run", RUNS)
def test_used_again_parts_give_the_bits_of_new_ones(run: str) -> None:
    for change in np.random.default_rng(1).permutation([*ANY, *RUNS[run], *ANY, *RUNS[run]]):
        case = load_case(run, ["duration=0.5", change])
        assert digest(loop.run(case)) == digest(loop.finish(case, loop.build_loop(case))), change


class Thinks:
    """A controller that simulates its own run, without itself, in its second step."""

    def __init__(self, _spec: Any) -> None:
        self.steps = 0

    def step(self, _t_s: float, _y: Any, _age_s: Any, _fresh: Any) -> list[float]:
        """No setpoint."""
        self.steps += 1
        if self.steps == 2:
            loop.run(load_case("two_area_deployment", ["duration=0.5"]))
        return [0.0]


def test_run_within_a_run_has_parts_of_its_own() -> None:
    sets = ["duration=0.5", f"controllers=[{{name: mine, policy: {__name__}:Thinks}}]", "supervision=null"]
    case = load_case("two_area_deployment", sets)
    whole = digest(loop.run(case))
    assert digest(loop.run(case)) == whole
    assert digest(loop.finish(case, loop.build_loop(case))) == whole
    with parts.lent() as part:
        assert part is not parts.new
