"""Search of a margin: the values to run next, and the result of those that were run.

A coarse grid comes first, so that a failure at one value is noticed even if larger values hold. Then each change is
bisected. The result is the set of values that hold; the margin is the first edge of it. The search sees only whether a
value failed.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from scipy import stats

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping_studies.parameters import Margin

DIGITS = 9  # decimals of a bisected value
CONFIDENCE = 0.95
RESAMPLES = 2000
CHANGES = 3  # changes that a search may refine, for its progress


class Bracket(NamedTuple):
    """Bracket of a margin: the criterion holds at `low` and fails at `high`.

    `low` None: it fails at the lowest value; `high` None: it never fails. `again`: higher values that hold again.
    """

    low: float | None
    high: float | None
    again: list[float]


class OverSeeds(NamedTuple):
    """The median margin over seeds; None where it lies beyond the values that were run."""

    margin_s: float | None  # median of the middles of the brackets
    low_s: float | None  # ends of the bootstrap 95 % intervals of the medians of the lower and the upper ends;
    high_s: float | None  # for one seed those of its bracket
    seeds: int
    monotonic: bool  # no seed holds again at a higher value
    holds_again: list[float]  # such values, of all seeds
    beyond: Literal["low", "high"] | None  # where the margin lies beyond the values that were run
    per_seed: list[float | None] | None  # margins of several seeds
    field: str  # column of the value


class FailedFraction(NamedTuple):
    """The fraction of failed runs with Wilson's 95 % interval."""

    runs: int
    failed: int
    fraction: float
    low: float
    high: float


def grid(margin: Margin) -> list[float]:
    """The coarse grid."""
    return [round(float(value), DIGITS) for value in np.linspace(margin.low, margin.high, margin.coarse)]


def bracket(failed: Mapping[float, bool | None]) -> Bracket:
    """The bracket of the first failure; undecided values (None) are ignored."""
    known = _known(failed)
    first = next((i for i, value in enumerate(known) if failed[value]), None)
    if first is None:
        return Bracket(known[-1] if known else None, None, [])
    again = [value for value in known[first:] if not failed[value]]
    return Bracket(known[first - 1] if first else None, known[first], again)


def wanted(margin: Margin, failed: Mapping[float, bool | None]) -> list[float]:
    """Values to run next; empty when the search has ended."""
    missing = [value for value in grid(margin) if value not in failed]
    if missing:
        return missing
    wide = [(low, high) for low, high in changes(failed) if high - low > margin.tolerance * (1 + 1e-9)]
    middles = [round((low + high) / 2, DIGITS) for low, high in wide]
    return [middle for middle in middles if middle not in failed]


def changes(failed: Mapping[float, bool | None]) -> list[tuple[float, float]]:
    """Neighbouring values of which one fails and one holds; undecided values (None) are ignored."""
    known = _known(failed)
    return [(low, high) for low, high in pairwise(known) if failed[low] != failed[high]]


def holding(searches: Sequence[Mapping[float, bool | None]]) -> list[list[float]]:
    """Intervals of the values at which the criterion holds, in at least half of the searches.

    An edge is the middle of the values that hold and fail beside it; the first and last value are those that were run.
    """
    run = [(failed, values) for failed in searches if (values := _known(failed))]
    points = {end for _, values in run for end in (values[0], values[-1])}
    points |= {(low + high) / 2 for failed, _ in run for low, high in changes(failed)}
    intervals: list[list[float]] = []
    for low, high in pairwise(sorted(points)):
        holds = [_holds(failed, values, (low + high) / 2) for failed, values in run]
        if 2 * sum(holds) < len(holds):
            continue
        if intervals and intervals[-1][1] == low:
            intervals[-1][1] = high
        else:
            intervals.append([low, high])
    return [[round(end, DIGITS) for end in interval] for interval in intervals]


def _known(failed: Mapping[float, bool | None]) -> list[float]:
    """The values whose runs were possible, ascending."""
    return sorted(value for value, fails in failed.items() if fails is not None)


def _holds(failed: Mapping[float, bool | None], values: Sequence[float], at: float) -> bool:
    """Whether a search holds at a value: as at the nearest one that was run."""
    return not failed[min(values, key=lambda value: abs(value - at))]


def held(margin: Margin, searches: Sequence[Mapping[float, bool | None]]) -> float | None:
    """Fraction of the coarse grid's values at which the criterion holds, over all searches; None without any run."""
    known = [not failed[value] for failed in searches for value in grid(margin) if failed.get(value) is not None]
    return float(np.mean(known)) if known else None


def max_runs(margin: Margin) -> int:
    """Number of runs of a search, about."""
    step = (margin.high - margin.low) / (margin.coarse - 1)
    return margin.coarse + len(margin.criteria) * CHANGES * max(
        0, int(np.ceil(np.log2(step / margin.tolerance) - 1e-9))
    )


def over_seeds(brackets: Sequence[Bracket], margin: Margin, seed: int) -> OverSeeds:
    """The median margin over seeds with an interval; `seed`: of the bootstrap."""
    lows = np.array([-np.inf if seed_bracket.low is None else seed_bracket.low for seed_bracket in brackets])
    highs = np.array([np.inf if seed_bracket.high is None else seed_bracket.high for seed_bracket in brackets])
    with np.errstate(invalid="ignore"):
        middles = (lows + highs) / 2.0  # not a number where nothing was run
    return OverSeeds(
        margin_s=_finite(np.median(middles)),
        low_s=_finite(_end(lows, 0, seed)),
        high_s=_finite(_end(highs, 1, seed)),
        seeds=len(brackets),
        monotonic=not any(seed_bracket.again for seed_bracket in brackets),
        holds_again=sorted({value for seed_bracket in brackets for value in seed_bracket.again}),
        beyond="low" if np.median(middles) == -np.inf else "high" if np.median(middles) == np.inf else None,
        per_seed=[_finite(value) for value in middles] if len(brackets) > 1 else None,
        field=margin.column,
    )


def _end(values: np.ndarray[Any, Any], end: int, seed: int) -> float:
    """An end of the interval of the median; for one value the value itself."""
    if np.all(values == values[0]):
        return float(values[0])
    resampled = np.random.default_rng(seed).choice(values, (RESAMPLES, len(values)))
    tail = (1 - CONFIDENCE) / 2
    # An order statistic without interpolation, as some values may be infinite.
    method = "lower" if end == 0 else "higher"
    return float(np.quantile(np.median(resampled, axis=1), 1 - tail if end else tail, method=method))  # type: ignore[call-overload]


def failed_fraction(failed: int, of: int) -> FailedFraction:
    """The fraction of failed runs with Wilson's 95 % interval."""
    low, high = stats.binomtest(failed, of).proportion_ci(CONFIDENCE, method="wilson")
    return FailedFraction(of, failed, failed / of, float(low), float(high))


def _finite(value: float) -> float | None:
    return round(float(value), DIGITS) if np.isfinite(value) else None
