"""The large case by this package, imported from its files."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.bench.grid import DURATION, FAULT_END, FAULT_START, FAULT_X, RATE, Grid, TimedRun
from facts_damping.bench.large import BUS, files
from facts_damping.case.loading import make_case
from facts_damping.grid_formats.psse import import_case
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from pathlib import Path


def prepare(grid: Grid, folder: Path) -> dict[str, Any]:  # noqa: ARG001 (what every program's module takes)
    """The system, as the import makes it."""
    return import_case(*files()).content


def run(made: dict[str, Any], grid: Grid, step: float, **_twin: Any) -> TimedRun:  # noqa: ARG001
    """One run; its set-up solves the power flow, starts machines and controls, and reduces the network."""
    began = time.perf_counter()
    fault = {"time": FAULT_START, "kind": "fault", "bus": f"B{BUS}", "duration": FAULT_END - FAULT_START, "x": FAULT_X}
    run = {"system": {**made, "step": step}, "scenario": [fault], "duration": DURATION, "frame_rate": RATE}
    parts = loop.build_loop(make_case({**run, "devices": [], "controllers": []}, "bench"))
    ready = time.perf_counter()
    loop.run_loop(parts)
    ended = time.perf_counter()
    ticks, kept = int(parts.signals.used[0]), parts.signals
    time_s = np.asarray(kept.time_ns[:ticks] * 1e-9, np.float64)
    return TimedRun(ready - began, ended - ready, time_s, kept.machines["speed_deviation"][:ticks])
