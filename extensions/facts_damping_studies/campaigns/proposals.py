"""Points of the unit cube worth trying for the least of several objectives at once.

Each point is a case of a campaign: some coordinates choose from lists, the others are amounts. Every evaluation tells
the margins of all rules, so the points of all rules are one pool. The first points fill the cube evenly. Then a rule's
next point is a mutation of one of its best. Parents are the best of each kind of case, which is base run and fault
(J.-B. Mouret, J. Clune, arXiv:1504.04909), half of them of other base runs than that of the best.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import qmc

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

FRESH = 0.15  # probability of a point anywhere
ENDS = 0.2  # probability that an amount drawn anew is at an end
CROSSED = 0.3  # probability that coordinates of a second parent are taken
STEPS = (1e-2, 0.3)  # standard deviation of a move of amounts, log-uniform
CHANGED = 2.0  # coordinates that change, on average
MOVED = 0.5  # probability that an amount that changes moves; else it is drawn anew
BEST = 8  # kinds whose best are parents
OTHERS = 0.5  # probability of a parent in other base runs than that of the best
PATIENCE = 5  # generations


def spread(many: int, amounts: NDArray[np.bool_], random: np.random.Generator) -> NDArray[np.float64]:
    """A Latin hypercube, (many, coordinates), some amounts at an end; `amounts`: which coordinates are."""
    at = qmc.LatinHypercube(len(amounts), rng=random).random(many)
    return _inside(np.where(amounts & (random.random(at.shape) < ENDS), np.round(at), at))


def proposal(
    points: NDArray[np.float64],
    kinds: Sequence[tuple[Any, Any]],
    margins: NDArray[np.float64],
    amounts: NDArray[np.bool_],
    random: np.random.Generator,
) -> NDArray[np.float64]:
    """The next point, (coordinates,), from those evaluated, (points, coordinates), with their kinds and margins."""
    best = parents(kinds, margins)
    anew = spread(1, amounts, random)[0]
    if not best or random.random() < FRESH:
        return np.asarray(anew)
    others = [i for i in best if kinds[i][0] != kinds[best[0]][0]]
    near = [i for i in best if i not in others]
    best = (others if others and random.random() < OTHERS else near)[:BEST]
    child = points[best[int(len(best) * random.random() ** 2)]]  # the better, the likelier
    if random.random() < CROSSED:
        child = np.where(random.random(len(amounts)) < 0.5, child, points[random.choice(best)])
    some = random.random(len(amounts)) < CHANGED / len(amounts)
    some[random.integers(len(amounts))] = True
    step = np.exp(random.uniform(*np.log(STEPS))) * random.standard_normal(len(amounts))
    moves = random.random(len(amounts)) < MOVED
    return _inside(np.where(some, np.where(moves & amounts, np.abs(child + step), anew), child))


def _inside(at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points with what is above one reflected there; one itself is just below."""
    return np.asarray(np.minimum(np.where(at > 1.0, np.abs(2.0 - at) % 1.0, at), np.nextafter(1.0, 0.0)))


def parents(kinds: Sequence[tuple[Any, Any]], margins: NDArray[np.float64]) -> list[int]:
    """Indices of the best point of each of the best kinds, the best first; none with an infinite margin."""
    best: dict[tuple[Any, Any], int] = {}
    for i in np.argsort(margins, kind="stable").tolist():
        if not np.isfinite(margins[i]):
            break
        best.setdefault(kinds[i], i)
    return list(best.values())


def turns(bests: NDArray[np.float64], many: int) -> list[int]:
    """Whose turn it is: so many indices of rules; `bests`: (generations, rules), the least margins up to each.

    Rules that no point violates, and whose least margin has not changed by 1 % within `PATIENCE` generations, share one
    turn of a generation.
    """
    since = bests[-1 - PATIENCE] if len(bests) > PATIENCE else np.full(bests.shape[1:], np.inf)
    last = bests[-1] if len(bests) else np.zeros(bests.shape[1:])
    moves = (since - last > 0.01 * np.abs(last)) | (last < 0.0)
    still, moving = (np.flatnonzero(which).tolist() for which in (~moves, moves))
    rare = [still[len(bests) % len(still)]] if still else []
    return sorted([*rare, *(moving or still) * many][:many])
