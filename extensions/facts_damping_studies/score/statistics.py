"""Statistics of a score: changes, their intervals by event, groups of controllers, kinds that tell nobody apart.

Of a controller in case c, r_c = log(index / index without control), clipped at +-LOST. Cases belong to kinds and to
events; several cases of a kind may be of the same event, and several kinds may be of the same events. With the means
m_ke over the cases of event e of kind k,

    change = mean_k mean_e m_ke,  in percent 100 (exp(change) - 1)

In a resample, n events are drawn with replacement from the n events of all kinds that share events, jointly for these
kinds and for all controllers, so that differences between controllers are paired. The deviation of the mean of a kind
of n events from m_k is multiplied by sqrt(n / (n - 1)): the variance of n values is smaller than that of what they are
drawn from by (n - 1) / n, which matters with six. Of 2000 sets of ten kinds of six events, intervals of 95 % held the
truth in 91.6 % without the factor and in 93.9 % with it, where ratios are normal; in 90.0 and 92.7 % where they are
exponential, which log ratios within +-LOST are not (tests/studies/test_score_statistics.py).

B. Efron and R. J. Tibshirani, An Introduction to the Bootstrap, 1993, 6.5 (the factor) and 13 (percentiles).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

LOST = float(np.log(10.0))  # log ratio of a case that only the controller loses, and the largest
RESAMPLES, CONFIDENCE = 2000, 0.95
HOLDS = 0.99  # of resamples, in which the order of controllers of different groups holds
LEAST = 0.01  # of the index, reduction by the reference on which a scale can be built
ZERO = 0.01  # log ratio below which a controller changes nothing in a case
NEARLY_ALL = 0.9  # of all cases of all controllers, beyond which those at the cap or at zero are too many
HELPS = 0.1  # of the index, reduction that some controller has in a kind in which one can help
DIGITS = 4  # of all figures of a card


class Estimate(NamedTuple):
    """Change against a reference in percent, negative is less, with its 95 % interval."""

    percent: float
    low: float
    high: float


class Score(NamedTuple):
    """Score between no control, 0, and the upper reference, 100, with its 95 % interval."""

    value: float
    low: float
    high: float


class Changes(NamedTuple):
    """Mean log ratios of controllers in kinds of cases, and the same in joint resamples of the events."""

    kinds: tuple[str, ...]
    by_kind: Array  # (controllers, kinds)
    drawn_by_kind: Array  # (controllers, kinds, RESAMPLES)

    @property
    def change(self) -> Array:
        """Mean over kinds, (controllers,)."""
        mean: Array = self.by_kind.mean(axis=1)
        return mean

    @property
    def drawn(self) -> Array:
        """Mean over kinds in each resample, (controllers, RESAMPLES)."""
        mean: Array = self.drawn_by_kind.mean(axis=1)
        return mean


def changes(ratios: Array, kinds: Sequence[str], events: Sequence[Hashable], seed: int) -> Changes:
    """Mean log ratios and their resamples.

    `ratios`: (controllers, cases); `kinds`, `events`: of each case, events with the same id are the same; `seed`: from
    the digest of the set. A kind of a single event has no deviation. Raises `InputError` for ratios that are not
    finite.
    """
    if not np.isfinite(ratios).all():
        raise InputError("log ratios: one that is not finite given; allowed: from -log 10 to log 10")
    random, names = np.random.default_rng(seed), tuple(dict.fromkeys(kinds))
    members = [
        list(dict.fromkeys(event for kind, event in zip(kinds, events, strict=True) if kind == name)) for name in names
    ]
    counts = {event: draws for family in _families(members) for event, draws in _draws(family, random)}
    means, drawn = [], []
    for name, ids in zip(names, members, strict=True):
        at = [[c for c, case in enumerate(zip(kinds, events, strict=True)) if case == (name, id_)] for id_ in ids]
        values = np.stack([ratios[:, cases].mean(axis=1) for cases in at], axis=1)
        means.append(values.mean(axis=1))
        drawn.append(means[-1][:, np.newaxis] + _deviations(values, np.stack([counts[id_] for id_ in ids])))
    return Changes(names, np.stack(means, axis=1), np.stack(drawn, axis=1))


def _families(members: Sequence[Sequence[Hashable]]) -> list[list[Hashable]]:
    """Events of kinds that share events, directly or by another kind, in the order in which they come."""
    families: list[list[Hashable]] = []
    for events in members:
        joined = [family for family in families if not set(family).isdisjoint(events)]
        families = [family for family in families if family not in joined]
        families.append(list(dict.fromkeys(event for family in [*joined, list(events)] for event in family)))
    return families


def _draws(family: Sequence[Hashable], random: np.random.Generator) -> list[tuple[Hashable, NDArray[np.int64]]]:
    """How often each event of a family is drawn in each resample, (RESAMPLES,)."""
    n = len(family)
    return list(zip(family, random.multinomial(n, np.full(n, 1.0 / n), size=RESAMPLES).T, strict=True))


def _deviations(values: Array, counts: NDArray[np.int64]) -> Array:
    """Deviations of a kind's mean in resamples, with the factor, (controllers, RESAMPLES).

    `values`: (controllers, events); `counts`: (events, RESAMPLES); 0 where a kind that shares only a part of its events
    has none of them in a resample.
    """
    n, drawn = counts.shape[0], counts.sum(axis=0)
    sums = (values - values.mean(axis=1, keepdims=True)) @ counts
    deviations: Array = sums / np.maximum(drawn, 1) * np.sqrt(n / max(n - 1, 1))
    return deviations


def estimate(change: float, drawn: Array) -> Estimate:
    """A mean log ratio and its resamples, (RESAMPLES,), as a change in percent."""
    return Estimate(*(rounded(100.0 * (np.exp(x) - 1.0)) for x in (change, *interval(drawn))))


def interval(drawn: Array) -> tuple[float, float]:
    """The middle 95 % of resamples."""
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return float(low), float(high)


def rounded(value: float) -> float:
    """A figure with as many digits as a card shows."""
    return float(f"{value:.{DIGITS}g}") + 0.0  # no negative zero


def change_of(changed: Changes, a: int) -> Estimate:
    """Change of controller a against no control."""
    return estimate(changed.change[a], changed.drawn[a])


def change_in(changed: Changes, a: int, kind: str) -> Estimate:
    """Change of controller a against no control in a kind."""
    k = changed.kinds.index(kind)
    return estimate(changed.by_kind[a, k], changed.drawn_by_kind[a, k])


def paired(changed: Changes, a: int, b: int) -> Estimate:
    """Change of controller a against controller b in the same cases."""
    change, drawn = changed.change, changed.drawn
    return estimate(change[a] - change[b], drawn[a] - drawn[b])


def score_of(changed: Changes, a: int, reference: int) -> Score:
    """Score of controller a: the part of what can be avoided that it avoids.

        score = 100 (1 - exp(change)) / (1 - exp(change of the reference))

    The interval is of joint resamples, so it contains the uncertainty of the reference. The ratio is of reductions, not
    of logarithms, as a reduction is what a grid gets: with logarithms the last 3 % that a reference of -97 % has before
    a controller of -94 % would count as much as the first 50 %, and a score would depend mostly on what is hardly
    seen. Raises `InputError` for a reference that does not surely reduce the index by 1 %.
    """
    reduction, drawn = 1.0 - np.exp(changed.change), 1.0 - np.exp(changed.drawn)
    surely = interval(drawn[reference])[0]
    if surely < LEAST:
        raise InputError(f"reference: a sure reduction of {100.0 * surely:.2g} % given; allowed: from 1 % on")
    scores = 100.0 * drawn[a] / np.maximum(drawn[reference], LEAST)
    value = 100.0 * reduction[a] / reduction[reference]
    return Score(*(rounded(x) for x in (float(value), *interval(scores))))


def probability(changed: Changes) -> Array:
    """Probability of each controller that it is the best of all, (controllers,): of resamples; a tie is divided."""
    drawn = changed.drawn
    best = drawn == drawn.min(axis=0)
    divided: Array = (best / best.sum(axis=0)).mean(axis=1)
    return divided


def groups(changed: Changes) -> list[list[int]]:
    """Groups of controllers, the best group first, in each the best controller first.

    Two controllers are in different groups only if their order holds in 99 % of resamples; so a border between
    neighbours has to hold for all pairs across it. In sets of cases drawn anew, 99.5 % of the pairs of different groups
    kept their order, and in 86 to 97 % of the sets all at once; with 97.5 % instead of 99 % in 78 to 92 % (400 sets of
    three fields of controllers; tests/studies/test_score_statistics.py has a part of it).
    """
    drawn, order = changed.drawn, [int(i) for i in np.argsort(changed.change, kind="stable")]
    holds = (drawn[order, np.newaxis] < drawn[order]).mean(axis=2) >= HOLDS  # [i, j]: i is better than j
    borders = [i for i in range(1, len(order)) if holds[:i, i:].all()]
    return [order[a:b] for a, b in zip([0, *borders], [*borders, len(order)], strict=True)]


def discriminates(ratios: Array, events: Sequence[Hashable]) -> tuple[bool, str]:
    """Whether a kind of cases tells which controllers are better, and if not why: then it is beside the score.

    `ratios`: log ratios of a field of controllers in the cases of the kind, (controllers, cases); `events`: of each
    case. It does not

    - if in more than 90 % of all cases of all controllers the ratio is at the cap, |r| = LOST, or at zero, |r| < 0.01;
    - or if no controller reduces the index by 10 %: the kind then tells who does less harm, as each card does,
      and in a mean over kinds one would win by doing nothing.
    """
    sizes = np.abs(ratios)
    stuck = float(((sizes < ZERO) | np.isclose(sizes, LOST)).mean())
    if stuck > NEARLY_ALL:
        return False, f"at the cap or at zero in {100.0 * stuck:.0f} % of the cases of {len(ratios)} controllers"
    if changes(ratios, [""] * ratios.shape[1], events, 0).change.min() > np.log(1.0 - HELPS):
        return False, f"none of {len(ratios)} controllers reduces the index by {100.0 * HELPS:.0f} %"
    return True, ""
