"""WECC-240 by this package, imported from its files, with ANDES's equations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.loading import make_case
from facts_damping_bench.grid import DURATION, RATE, Grid, TimedRun
from facts_damping_bench.ours import timed
from facts_damping_bench.wecc import UNIT
from facts_damping_validation.as_there import models_with
from facts_damping_validation.wecc240 import CONTROLS_AS_THERE, TRIP, as_there

if TYPE_CHECKING:
    from pathlib import Path


def prepare(grid: Grid, folder: Path) -> dict[str, Any]:  # noqa: ARG001 (what every program's module takes)
    """The system, as the import makes it, with ANDES's equations."""
    return as_there(stabilisers=False)


def run(prepared: dict[str, Any], grid: Grid, step: float, **_twin: Any) -> TimedRun:  # noqa: ARG001
    """One run; its set-up solves the power flow, starts machines, inverters and controls, and reduces the network."""
    run = {"system": {**prepared, "step": step}, "scenario": [TRIP], "duration": DURATION, "frame_rate": RATE}
    with models_with(CONTROLS_AS_THERE):
        timed_run = timed(lambda: make_case({**run, "devices": [], "controllers": []}, "bench"))
    stays = [machine["name"] != UNIT for machine in prepared["machines"]]
    return timed_run._replace(speeds=np.asarray(timed_run.speeds[:, stays]))
