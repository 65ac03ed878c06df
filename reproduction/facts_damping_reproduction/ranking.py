"""Orders of controllers, theirs and ours: rank correlation, the best two, and who is far from its place.

Within a table, a scenario, a quantity and a scheme the controllers are ordered by the figure itself: theirs by the
improvement over LLC as corrected (or the roughness), ours by the index (or the roughness). LLC on the SSSC alone is
the reference of all tables and has no place; with SSSC and STATCOM it has one. Equal figures share the mean of their
places; runs without figures share the last places. Runs whose figures are not converged have no place, neither theirs
nor ours. MISO columns of table 6.1 repeat table 5.4 and are left out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import permutation_test, rankdata

from facts_damping_reproduction.printed import LLC

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from facts_damping_reproduction.agreement import Compared

FAR = 5  # places: controllers that differ by more are named
RESAMPLES = 9_999


class Ranking(NamedTuple):
    """An order of controllers, best first as the thesis has it."""

    table: str
    scenario: str
    quantity: str
    scheme: str
    controllers: tuple[str, ...]
    theirs: tuple[float, ...]  # places, 1 is best
    ours: tuple[float, ...]
    missing: tuple[str, ...]  # without our figures
    rho: float | None  # Spearman's; none where all have the same place
    p: float | None  # two-sided, of a correlation so far from 0 between orders that have nothing to do with each other
    best: tuple[str, ...]  # theirs; several where they are equal
    second: tuple[str, ...]
    best_ours: tuple[str, ...]
    second_ours: tuple[str, ...]
    far: tuple[str, ...]  # with both places, where they differ by more than FAR
    same_best: bool
    same_second: bool
    same_two: bool  # in any order


class RankTotal(NamedTuple):
    """Rankings of a table, or of all."""

    table: str
    rankings: int
    mean_rho: float | None  # over those that have one
    lowest_rho: float | None
    highest_rho: float | None
    same_best: int
    same_second: int
    same_two: int
    far: int  # controllers far from their place


class MeanRank(NamedTuple):
    """A controller's mean place over the scenarios of a table."""

    table: str
    quantity: str
    scheme: str
    controller: str
    theirs: float
    ours: float


def rankings(compared: Iterable[Compared], seed: int = 0) -> list[Ranking]:
    """The orders in figures that were compared; `seed` is of the permutations where not all are tried."""
    groups: dict[tuple[str, str, str, str], list[Compared]] = {}
    for c in compared:
        cell = c.cell
        repeated = cell.table == "6.1" and cell.architecture == "MISO"
        if cell.against in (None, LLC) and cell.who != LLC and not repeated and c.converged:
            groups.setdefault((cell.table, cell.scenario, cell.quantity, cell.scheme or "indirect"), []).append(c)
    return [_ranking(key, group, seed) for key, group in groups.items()]


def totals(orders: Sequence[Ranking]) -> list[RankTotal]:
    """Sums by table, then of all."""
    tables = list(dict.fromkeys(r.table for r in orders))
    rows = [_total(table, [r for r in orders if r.table == table]) for table in tables]
    return [*rows, _total("all", orders)] if orders else rows


def mean_ranks(orders: Sequence[Ranking]) -> list[MeanRank]:
    """Mean places over the scenarios, by table, quantity and scheme, best first as the thesis has it."""
    places: dict[tuple[str, str, str, str], list[tuple[float, float]]] = {}
    for r in orders:
        for name, theirs, ours in zip(r.controllers, r.theirs, r.ours, strict=True):
            places.setdefault((r.table, r.quantity, r.scheme, name), []).append((theirs, ours))
    rows = [MeanRank(*key, *(float(x) for x in np.mean(pairs, axis=0))) for key, pairs in places.items()]
    order = list(dict.fromkeys(row[:3] for row in rows))
    return sorted(rows, key=lambda row: (order.index(row[:3]), row.theirs))


def rho(first: NDArray[np.float64], other: NDArray[np.float64]) -> float | None:
    """Spearman's rank correlation; none where one of the two has no order."""
    a, b = rankdata(first), rankdata(other)
    return float(np.corrcoef(a, b)[0, 1]) if np.ptp(a) > 0.0 and np.ptp(b) > 0.0 else None


def correlation(theirs: Sequence[float], ours: Sequence[float], seed: int = 0) -> tuple[float | None, float | None]:
    """Spearman's rank correlation of two lists of places and its two-sided p; none where one of them is all equal.

    With so few controllers p is not taken from the t distribution but from permutations of `ours`: all of them up to
    seven controllers, otherwise 9999 drawn with the seed.
    """
    coefficient = rho(np.array(theirs), np.array(ours))
    if coefficient is None:
        return None, None
    a = _standard(rankdata(theirs))

    def statistic(b: NDArray[np.float64], axis: int = -1) -> NDArray[np.float64]:
        return np.asarray(np.sum(a * b, axis=axis))

    test = permutation_test(
        (_standard(rankdata(ours)),),
        statistic,
        permutation_type="pairings",
        vectorized=True,
        n_resamples=RESAMPLES,
        rng=np.random.default_rng(seed),
    )
    return coefficient, float(test.pvalue)


def _standard(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks with mean 0 and square sum 1: their product is the correlation."""
    centred = x - x.mean()
    return np.asarray(centred / np.linalg.norm(centred))


def _ranking(key: tuple[str, str, str, str], group: Sequence[Compared], seed: int) -> Ranking:
    smooth = group[0].cell.against is None
    printed = [c.cell.corrected if smooth else -c.cell.corrected for c in group]
    order = np.argsort(printed, kind="stable")
    names = [group[i].cell.controller for i in order]
    figures = [group[i].figure for i in order]
    theirs = [float(x) for x in np.sort(rankdata(printed))]
    ours = [float(x) for x in rankdata([math.inf if figure is None else figure for figure in figures])]
    known = [place for place, figure in zip(ours, figures, strict=True) if figure is not None]
    missing = tuple(name for name, figure in zip(names, figures, strict=True) if figure is None)
    places = zip(names, theirs, ours, strict=True)
    far = tuple(f"{name} ({a:g}, ours {b:g})" for name, a, b in places if abs(a - b) > FAR)
    (best, second), (best_ours, second_ours) = _first_two(names, theirs, theirs), _first_two(names, ours, known)
    same = (not {*best}.isdisjoint(best_ours), not {*second}.isdisjoint(second_ours))
    two = {*best, *second} == {*best_ours, *second_ours}
    fits = correlation(theirs, ours, seed)
    leaders = (best, second, best_ours, second_ours)
    return Ranking(*key, tuple(names), tuple(theirs), tuple(ours), missing, *fits, *leaders, far, *same, two)


def _first_two(
    names: Sequence[str], places: Sequence[float], allowed: Sequence[float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Who has the best of the places that are allowed, and who the next."""
    first, second, *_ = [*sorted(set(allowed)), math.nan, math.nan]
    best, next_best = (tuple(n for n, p in zip(names, places, strict=True) if p == x) for x in (first, second))
    return best, next_best


def _total(table: str, orders: Sequence[Ranking]) -> RankTotal:
    rhos = [r.rho for r in orders if r.rho is not None]
    mean, low, high = (float(np.mean(rhos)), min(rhos), max(rhos)) if rhos else (None, None, None)
    same = (sum(r.same_best for r in orders), sum(r.same_second for r in orders), sum(r.same_two for r in orders))
    return RankTotal(table, len(orders), mean, low, high, *same, sum(len(r.far) for r in orders))
