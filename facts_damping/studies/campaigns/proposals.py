"""Points of the unit cube worth trying for the least of several objectives at once.

Each point is a case of a campaign, some of its coordinates choose from lists, and every evaluation tells the margins of
all rules. So the points of all rules are one pool, and a rule's next point is a mutation of one of its best. Parents
are the best of each kind of case (J.-B. Mouret, J. Clune, arXiv:1504.04909), so that no kind is lost too early.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

UNSEEN = 0.8  # probability of a point anywhere for a rule that no point violates yet
FRESH = 0.3  # the same for one that is violated
CROSSED = 0.3  # probability that coordinates of a second parent are taken
ANEW = 0.5  # probability that a coordinate that changes is drawn anew; else it moves
CHANGED = 2.0  # coordinates that change, on average
STEPS = (1e-2, 0.3)  # standard deviations of a move, log-uniform
BEST = 8  # kinds whose best are parents
PATIENCE = 5  # generations


def proposal(
    points: NDArray[np.float64], kinds: Sequence[str], margins: NDArray[np.float64], random: np.random.Generator
) -> NDArray[np.float64]:
    """The next point, (coordinates,), from those evaluated, (points, coordinates), with their kinds and margins."""
    size = points.shape[1]
    best = points[parents(kinds, margins)]
    violated = len(margins) and margins.min() < 0.0
    if not len(best) or random.random() < (FRESH if violated else UNSEEN):
        return np.asarray(random.random(size))
    child = best[int(len(best) * random.random() ** 2)].copy()  # the better, the likelier
    if random.random() < CROSSED:
        child = np.where(random.random(size) < 0.5, child, best[random.integers(len(best))])
    changed = random.random(size) < CHANGED / size
    changed[random.integers(size)] = True
    step = np.exp(random.uniform(*np.log(STEPS))) * random.standard_normal(size)
    moved = np.where(random.random(size) < ANEW, random.random(size), np.abs(child + step) % 2.0)
    moved = np.minimum(np.where(moved > 1.0, 2.0 - moved, moved), np.nextafter(1.0, 0.0))
    return np.asarray(np.where(changed, moved, child))


def parents(kinds: Sequence[str], margins: NDArray[np.float64]) -> list[int]:
    """Indices of the best point of each of the best kinds, the best first; none with an infinite margin."""
    found: dict[str, int] = {}
    for i in np.argsort(margins, kind="stable").tolist():
        if len(found) == BEST or not np.isfinite(margins[i]):
            break
        found.setdefault(kinds[i], i)
    return list(found.values())


def turns(bests: NDArray[np.float64], many: int) -> list[int]:
    """Whose turn it is: so many indices of rules; `bests`: (generations, rules), the least margins up to each.

    A rule whose least margin has not changed by 1 % within `PATIENCE` generations gets a turn only once.
    """
    since = bests[-1 - PATIENCE] if len(bests) > PATIENCE else np.full(bests.shape[1:], np.inf)
    last = bests[-1] if len(bests) else np.zeros(bests.shape[1:])
    every = list(range(bests.shape[1]))
    moves = [rule for rule in every if since[rule] - last[rule] > 0.01 * abs(last[rule]) or last[rule] < 0.0]
    return sorted([*every, *(moves or every) * many][:many])
