"""Paired comparison of an index over the same draws: ratios with confidence intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Sequence

    from numpy.typing import NDArray

    Row = dict[str, Any]

CONFIDENCE = 0.95
RESAMPLES = 4000
MINIMUM = 4  # smallest number of pairs for an interval


class Effect(NamedTuple):
    """An index relative to a reference in the same draws: geometric mean of the ratio, and its 95 % interval.

    The interval is a bootstrap by resampling draws within their groups (B. Efron, R. J. Tibshirani, An Introduction to
    the Bootstrap, 1993, 13). Only draws in which both stay in synchronism count; with fewer than `MINIMUM` of them all
    three are None.
    """

    draws: int
    pairs: int  # draws in which both stay in synchronism
    lost: int  # draws in which it loses synchronism and the reference does not
    kept: int  # draws in which it keeps synchronism and the reference does not
    ratio: float | None
    low: float | None
    high: float | None

    @property
    def better(self) -> bool | None:
        """Whether it is better than the reference; None if the interval contains one."""
        if self.low is None or self.high is None or self.low <= 1.0 <= self.high:
            return None
        return self.high < 1.0


def by_draw(rows: Iterable[Row], columns: Sequence[str]) -> dict[Any, Row]:
    """Rows by the columns that identify a draw."""
    return {tuple(row[name] for name in columns): row for row in rows}


def effect(
    own: dict[Hashable, Row], reference: dict[Hashable, Row], group: Callable[[Row], Any], index: str = "ITAE"
) -> Effect:
    """The effect of rows relative to the reference in the same draws; the mean is over the groups' means."""
    both = [(own[key], reference[key]) for key in own if key in reference]
    stable = [(bool(a["stable"]), bool(b["stable"])) for a, b in both]
    logs: dict[Any, list[float]] = {}
    for (a, b), sound in zip(both, stable, strict=True):
        if all(sound):
            logs.setdefault(group(a), []).append(float(np.log(a[index] / b[index])))
    pairs = sum(map(len, logs.values()))
    ends = _interval(list(map(np.array, logs.values()))) if pairs >= MINIMUM else (None, None, None)
    return Effect(len(both), pairs, stable.count((False, True)), stable.count((True, False)), *ends)


def _interval(groups: Sequence[NDArray[np.float64]]) -> tuple[float, float, float]:
    """Geometric mean and the ends of its confidence interval."""
    random = np.random.default_rng(len(groups))
    means = np.mean([own[random.integers(len(own), size=(RESAMPLES, len(own)))].mean(axis=1) for own in groups], axis=0)
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(means, [tail, 1.0 - tail])
    middle = np.mean([own.mean() for own in groups])
    return float(np.exp(middle)), float(np.exp(low)), float(np.exp(high))


def agree(one: Effect, other: Effect) -> bool | None:
    """Whether two effects, from different draws, agree within their intervals; None if one has no interval.

    They agree if the logarithms differ by less than the root of the sum of the squared half-widths.
    """
    if one.ratio is None or other.ratio is None:
        return None
    half = [np.log(e.high / e.low) / 2.0 for e in (one, other) if e.low and e.high]
    return bool(abs(np.log(one.ratio / other.ratio)) <= np.hypot(*half))
