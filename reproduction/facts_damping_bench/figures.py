"""From runs to figures: error by step, time at equal error, ratios; no clock and no program in here."""

from __future__ import annotations

import math
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

EQUAL_ERROR = 1e-3  # of the largest swing


class Rung(NamedTuple):
    """A program at a step: its error, and medians of s for the run in time and for the set-up before it."""

    step_s: float
    error: float
    wall_s: float
    setup_s: float


class Sweep(NamedTuple):
    """Runs of varied load one after the other in one process, set-up included."""

    step_s: float
    runs: int
    run_s: float  # median of one


class Result(NamedTuple):
    """What is known of a program; `failed` says why it is left out, or left out of the rest."""

    name: str
    title: str
    version: str
    note: str
    failed: str = ""
    reference_step_s: float = math.nan
    from_ours: float = math.nan
    rungs: tuple[Rung, ...] = ()
    sweep: Sweep | None = None


class Equal(NamedTuple):
    """The coarsest step within the error, and the time that the error costs."""

    step_s: float
    error: float
    wall_s: float  # of that step
    at_error_s: float  # between it and the next coarser one, log-log; with the coarsest of all: its own


def difference(array_like: ArrayLike, reference: ArrayLike) -> float:
    """Largest difference of a machine's swing at an instant after the fault over the largest swing of the reference.

    A swing is a speed less the mean of all, so that the drift of a grid without governors hides nothing.
    """
    a, b = np.asarray(array_like), np.asarray(reference)
    return float(np.abs(a - b).max() / np.abs(b).max())


def rung(step: float, reference: ArrayLike, runs: Sequence[dict[str, Any]]) -> Rung:
    """Figures of the runs of a program with a step."""
    error = difference(runs[0]["swings"], reference)
    return Rung(step, error, median(run["wall_s"] for run in runs), median(run["setup_s"] for run in runs))


def at_equal_error(rungs: Sequence[Rung], error: float = EQUAL_ERROR) -> Equal | None:
    """What an error costs; None where no step reaches it. Nothing is extrapolated."""
    before: Rung | None = None
    for step_rung in rungs:
        if step_rung.error <= error:
            took = step_rung.wall_s
            if before is not None:
                fraction = math.log(before.error / error) / math.log(before.error / step_rung.error)
                took = before.wall_s * (step_rung.wall_s / before.wall_s) ** fraction
            return Equal(step_rung.step_s, step_rung.error, step_rung.wall_s, took)
        before = step_rung
    return None


def sweep_step(rungs: Sequence[Rung]) -> float:
    """Step of a sweep: the coarsest within the error, or the finest."""
    equal = at_equal_error(rungs)
    return rungs[-1].step_s if equal is None else equal.step_s


def ratio(value: float | None, ours: float | None) -> float:
    """How many times ours; NaN where one of them is not known."""
    return value / ours if value is not None and ours else math.nan
