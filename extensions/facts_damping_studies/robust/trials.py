"""Nonlinear runs by which laws are compared: events drawn for the grid, with limits and rates, without noise.

Each event is one that keeps synchronism without control. The index of a run is that of `score`; a law's figure is the
mean of ln of the index over that without control, and a law that loses synchronism is out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.loading import make_case
from facts_damping.errors import FactsDampingError
from facts_damping.simulation import loop
from facts_damping_studies.score.cases.drawing import EVENTS, Grid, event
from facts_damping_studies.score.measure import measured_from
from facts_damping_studies.score.reference import noiseless
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case

TRIALS, DRAWS = 6, 40  # events, and draws at most
START_S, AFTER_S = 1.0, 12.0  # of an event; how long the index counts after it


class Trial(NamedTuple):
    """A run of a law (a row of `controllers`; none: without control) in an event."""

    case: Case
    law: dict[str, Any] | None
    events: list[dict[str, Any]]


def drawn(
    case: Case, lines: Sequence[str], jobs: int, progress: Callable[[int, int], None]
) -> list[tuple[Trial, float]]:
    """Events at some lines that keep synchronism without control, as trials without a law, and their indices."""
    random = np.random.default_rng([case.run.seed, TRIALS])
    content = case.system.model_dump(by_alias=True)
    channel = "frequency"
    grid = Grid({"load_noise": None}, content, case.system, list(lines), [], channel)
    trials: list[tuple[Trial, float]] = []
    for first in range(0, DRAWS, TRIALS):
        kinds = [EVENTS[(first + i) % len(EVENTS)] for i in range(TRIALS)]
        more = [Trial(case, None, event(grid, random, kind, START_S)) for kind in kinds]
        indices = run_all(index, more, jobs, progress)
        trials += [(trial, of) for trial, of in zip(more, indices, strict=True) if of is not None and of > 0.0]
        if len(trials) >= TRIALS:
            break
    return trials[:TRIALS]


def index(trial: Trial) -> float | None:
    """ITAE of the speed differences of a trial's run; None: it loses synchronism, or is impossible."""
    last = max(each["time"] for each in trial.events)
    try:
        case = made(trial, last + AFTER_S)
        return measured_from(case, loop.run(case), None, AFTER_S).measure
    except FactsDampingError:
        return None


def made(trial: Trial, duration: float) -> Case:
    """The case of a trial: without noise, supervisor and watchdog."""
    case, rows = trial.case, [] if trial.law is None else [trial.law]
    content = {
        **case.document(),
        "scenario": trial.events,
        "controllers": rows,
        "duration": duration,
        "supervision": None,
        "watchdog": None,
        "arm_at": None,
    }
    content.pop("asked", None)
    return noiseless(make_case(content, "design"))


def compared(
    trials: Sequence[tuple[Trial, float]],
    laws: Sequence[dict[str, Any]],
    jobs: int,
    progress: Callable[[int, int], None],
) -> list[float]:
    """Mean of ln of the index over that without control of each law; infinite: it loses synchronism in an event."""
    tasks = [trial._replace(law=law) for law in laws for trial, _ in trials]
    indices = np.array([np.inf if of is None else of for of in run_all(index, tasks, jobs, progress)])
    none = np.array([without for _, without in trials])
    ratios = np.maximum(indices.reshape(len(laws), len(trials)), 1e-12) / none
    return [float(value) for value in np.log(ratios).mean(axis=1)]
