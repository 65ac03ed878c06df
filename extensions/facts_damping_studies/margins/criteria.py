"""Criteria of margins: when a run fails, and the columns of its row that say so."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.analysis.verdict import DAMPED, GROWING, LIMIT_CYCLE, LOST
from facts_damping_studies.margins.delay_margin import STILL
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, link_delays, sampled
from facts_damping_studies.margins.unsupervised import unsupervised
from facts_damping_studies.parameters import DAMPING_RATIO

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.analysis.modes.ringdown import RingdownMode
    from facts_damping.analysis.summary import ModeFit, Summary
    from facts_damping.case.model import Case

STRONG = 0.1  # of the amplitude of the largest mode; weaker modes do not count for `damping`


class CriterionFigures(NamedTuple):
    """What criteria need to know of a run; None: not asked for, or not defined."""

    verdict: str
    lowest_damping_ratio: float | None = None  # of the modes that matter; None: none is seen
    ITAE_ratio: float | None = None  # to the run without control; None: one of them loses synchronism
    linear_growth_per_s: float | None = None  # largest growth rate of the linear closed loop, 1/s


class Criterion(NamedTuple):
    """What a run fails by, and what it is otherwise, in words; whether it fails, with the smallest damping ratio."""

    words: str
    holds: str
    fails: Callable[[CriterionFigures, float], bool]


def _damped_too_little(run: CriterionFigures, ratio: float) -> bool:
    lowest = run.lowest_damping_ratio
    return run.verdict in (LOST, GROWING, LIMIT_CYCLE) or (lowest is not None and lowest < ratio)


def _worse(run: CriterionFigures, _: float) -> bool:
    return run.verdict == LOST or (run.ITAE_ratio is not None and run.ITAE_ratio > 1.0)


def _grows(run: CriterionFigures, _: float) -> bool:
    return run.linear_growth_per_s is not None and run.linear_growth_per_s > STILL


CRITERIA = {
    "unstable": Criterion("loses synchronism", "in synchronism", lambda run, _: run.verdict == LOST),
    "not_damped": Criterion("is not damped", "damped", lambda run, _: run.verdict != DAMPED),
    "damping": Criterion("is damped too little", f"damped by {100 * DAMPING_RATIO:g} %", _damped_too_little),
    "worse": Criterion("is worse than without control", "better than no control", _worse),
    "linear": Criterion("is unstable in the linear model", "stable in the linear model", _grows),
}


def fails(criterion: str, run: CriterionFigures, ratio: float = DAMPING_RATIO) -> bool:
    """Whether a run fails a criterion."""
    return CRITERIA[criterion].fails(run, ratio)


def lowest_damping_ratio(modes: Sequence[ModeFit | RingdownMode]) -> float | None:
    """Smallest damping ratio of the modes that matter in a run's ringdown; None if none is seen."""
    largest = max((max(mode.amplitude) for mode in modes), default=0.0)
    return min((mode.damping_ratio for mode in modes if max(mode.amplitude) >= STRONG * largest), default=None)


def linear_growth(case: Case) -> float:
    """Largest growth rate of the linear closed loop at the delays of the run's links, 1/s.

    Raises `InputError` if the loop has no linear model.
    """
    loop = delayed_loop(unsupervised(case))
    return float(eigen(loop, sampled(loop, min(link_delays(case), default=0.0))).growth)


def itae_ratio(summary: Summary, free: Summary) -> float | None:
    """ITAE relative to the run without control, with noise that of the responses; None if either is lost."""
    if summary.indices_of_response and free.indices_of_response:
        return summary.indices_of_response["ITAE"] / free.indices_of_response["ITAE"]
    return summary.indices["ITAE"] / free.indices["ITAE"] if summary.indices and free.indices else None
