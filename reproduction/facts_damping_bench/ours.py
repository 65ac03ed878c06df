"""The case by this package."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.simulation import loop
from facts_damping.simulation.parts import lent
from facts_damping.simulation.tick import AT
from facts_damping_bench.grid import DURATION, Grid, TimedRun, case

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.case.model import Case


def prepare(grid: Grid, folder: Path) -> None:
    """Nothing: kernels compile in a run that is not counted."""


def run(
    prepared: None,  # noqa: ARG001 (what every program's module takes)
    grid: Grid,
    step: float,
    model: str = "genrou",
    more: tuple[str, ...] = (),
    end: float = DURATION,
) -> TimedRun:
    """One run; its set-up reads the file, solves the power flow, starts the machines and reduces the network.

    With another machine model, and more fields of the machines as of `--set`, it is the twin of another program.
    """
    return timed(lambda: case(step, grid.load, model, more, end))


def timed(make: Callable[[], Case]) -> TimedRun:
    """A run of a case, which is made as a part of its set-up."""
    began = time.perf_counter()
    with lent() as part:  # as in a sweep
        parts = loop.build_loop(make(), part=part)
        ready = time.perf_counter()
        loop.run_loop(parts)
    ended = time.perf_counter()
    ticks, signals = int(parts.signals.used[AT.ticks]), parts.signals
    time_s = np.asarray(signals.time_ns[:ticks] * 1e-9, np.float64)
    return TimedRun(ready - began, ended - ready, time_s, signals.machines["speed_deviation"][:ticks])
