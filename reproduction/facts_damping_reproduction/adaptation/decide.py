"""What follows from the experiment: ratios of two arms over search seeds and cases, and the decision by its rule."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping_studies.score.card import log_ratio
from facts_damping_studies.score.entries import NONE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

RESAMPLES, CONFIDENCE = 4000, 0.95
BETTER, WORSE, ALIKE, OPEN = "better", "worse", "no better", "cannot be told"


class Ratio(NamedTuple):
    """Index of an arm relative to another, geometric mean, with its interval over search seeds and cases."""

    arm: str
    against: str
    kinds: str
    ratio: float
    low: float
    high: float
    decision: str

    def text(self) -> str:
        """As a change in percent."""
        percent = [100.0 * (x - 1.0) for x in (self.ratio, self.low, self.high)]
        return f"{percent[0]:+.0f} % [{percent[1]:+.0f}, {percent[2]:+.0f}]"


def logs(experiment: Mapping[str, Any], arm: str) -> NDArray[np.float64]:
    """Log index relative to no control, (search seeds, cases); a loss counts as in scores."""
    none = experiment["rows"][NONE, 0]
    rows = [row for (name, _), row in sorted(experiment["rows"].items()) if name == arm]
    return np.array(
        [[log_ratio(a.get("index"), b.get("index")) for a, b in zip(row, none, strict=True)] for row in rows]
    )


def ratio(every: Sequence[Mapping[str, Any]], arm: str, against: str, kinds: Sequence[str], margin: float) -> Ratio:
    """Bootstrap: search seeds of each arm by themselves; within kinds of cases, kinds of events and cases of both.

    `every`: the results of one experiment, or of repetitions, which count alike.
    """
    random = np.random.default_rng(len(kinds))
    both = [_drawn(random, experiment, arm, against, kinds) for experiment in every]
    middle, drawn = float(np.mean([pair[0] for pair in both])), np.mean([pair[1] for pair in both], axis=0)
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = (float(x) for x in np.exp(np.quantile(drawn, [tail, 1.0 - tail])))
    return Ratio(arm, against, ", ".join(kinds), float(np.exp(middle)), low, high, decision(low, high, margin))


def _drawn(
    random: np.random.Generator, experiment: Mapping[str, Any], arm: str, against: str, kinds: Sequence[str]
) -> tuple[float, NDArray[np.float64]]:
    """The mean log ratio of an experiment, and that of each resample."""
    a = logs(experiment, arm)
    b = np.zeros_like(a[:1]) if against == NONE else logs(experiment, against)
    groups = [np.flatnonzero(np.array(experiment["kinds"]) == kind) for kind in kinds]
    events = np.array(experiment.get("events", experiment["kinds"]))
    of_a, of_b, drawn = _weights(random, len(a)), _weights(random, len(b)), np.zeros(RESAMPLES)
    for group in groups:
        cases = _of_cases(random, events[group])
        for log_ratios, seeds, sign in ((a, of_a, 1.0), (b, of_b, -1.0)):
            drawn += sign / len(groups) * np.einsum("rs,sc,rc->r", seeds, log_ratios[:, group], cases)
    return float(np.mean([(a.mean(axis=0) - b.mean(axis=0))[group].mean() for group in groups])), drawn


def _of_cases(random: np.random.Generator, events: NDArray[Any]) -> NDArray[np.float64]:
    """How much each case counts in each resample of the kinds of events, and of the cases of each kind."""
    names, kinds = np.unique(events, return_inverse=True)
    weights = _weights(random, len(names))[:, kinds]
    for k in range(len(names)):
        weights[:, kinds == k] *= _weights(random, int((kinds == k).sum()))
    return weights


def _weights(random: np.random.Generator, number: int) -> NDArray[np.float64]:
    """How much each of a number counts in each resample with replacement, (resamples, number)."""
    return random.multinomial(number, np.full(number, 1.0 / number), RESAMPLES) / number


def decision(low: float, high: float, margin: float) -> str:
    """The rule of the plan."""
    if high < 1.0 - margin:
        return BETTER
    if low > 1.0 + margin:
        return WORSE
    return ALIKE if low > 1.0 - margin else OPEN


def best_fixed(every: Sequence[Mapping[str, Any]], names: Sequence[str]) -> str:
    """The fixed arm whose searches ended lowest in training, on the mean over all."""
    values = {
        name: np.mean(
            [
                searched["value"]
                for experiment in every
                for (arm, _), searched in experiment["searches"].items()
                if arm == name
            ]
        )
        for name in names
    }
    return min(values, key=values.__getitem__)
