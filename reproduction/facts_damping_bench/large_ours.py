"""The large case by this package, imported from its files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.case.loading import make_case
from facts_damping_bench.grid import DURATION, FAULT_END, FAULT_START, FAULT_X, RATE, Grid, TimedRun
from facts_damping_bench.large import BUS, files
from facts_damping_bench.ours import timed
from facts_damping_grids.psse.conversion import import_case

if TYPE_CHECKING:
    from pathlib import Path


def prepare(grid: Grid, folder: Path) -> dict[str, Any]:  # noqa: ARG001 (what every program's module takes)
    """The system, as the import makes it, but for torques: of ANDES's turbines the speed divides no power."""
    content = import_case(*files()).content
    return content | {"machines": [row | {"speed_torque": False} for row in content["machines"]]}


def run(prepared: dict[str, Any], grid: Grid, step: float, **_twin: Any) -> TimedRun:  # noqa: ARG001
    """One run; its set-up solves the power flow, starts machines and controls, and reduces the network."""
    fault = {"time": FAULT_START, "kind": "fault", "bus": f"B{BUS}", "duration": FAULT_END - FAULT_START, "x": FAULT_X}
    run = {"system": {**prepared, "step": step}, "scenario": [fault], "duration": DURATION, "frame_rate": RATE}
    return timed(lambda: make_case({**run, "devices": [], "controllers": []}, "bench"))
