"""The large case by ANDES, loaded from its files; loads are impedances, as ours are."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import andes

from facts_damping_bench.grid import FAULT_END, FAULT_START, FAULT_X, Grid, TimedRun
from facts_damping_bench.large import BUS, files
from facts_damping_bench.with_andes import EVENT_DELAY, constant_impedances, simulated

if TYPE_CHECKING:
    from pathlib import Path


def prepare(grid: Grid, folder: Path) -> None:  # noqa: ARG001 (what every program's module takes)
    """Its equations as code, which it keeps in the user's folder."""
    andes.config_logger(stream_level=50)


def run(prepared: None, grid: Grid, step: float, **_twin: Any) -> TimedRun:  # noqa: ARG001
    """One run."""
    began = time.perf_counter()
    raw, dyr = files()
    ss = andes.load(str(raw), addfile=str(dyr), setup=False, no_output=True, default_config=True)
    ss.add("Fault", bus=BUS, tf=FAULT_START - EVENT_DELAY, tc=FAULT_END - EVENT_DELAY, rf=0.0, xf=FAULT_X)
    constant_impedances(ss)
    ss.setup()
    if not ss.PFlow.run():
        raise RuntimeError("the power flow does not converge")
    # Ours come by bus, and at one bus in the order of the RAW file, which gives the number of its static generator.
    at = [pair for model in (ss.GENROU, ss.GENCLS) for pair in zip(model.bus.v, model.gen.v, strict=True)]
    return simulated(ss, step, began, sorted(range(len(at)), key=lambda i: at[i]))
