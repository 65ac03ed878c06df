"""What chance decides of a link, drawn before a run: a delay, a loss or a copy for each entry of each channel.

The n-th entry of a channel takes the n-th draw, from the beginning again after the last one. So the link knows at once
when an entry arrives, and a node and the in-process loop know the same.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.parameters.link import LONGEST_S
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import NDArray

    Shape = tuple[int, int, int]  # (draws, copies, channels)

LOST = np.iinfo(np.int64).max  # in the place of a time: never


def _uniform(stage: Any, size: Shape, random: np.random.Generator) -> NDArray[np.float64]:
    return random.uniform(stage.low, stage.high, size)


def _normal(stage: Any, size: Shape, random: np.random.Generator) -> NDArray[np.float64]:
    """By rejection: at least a half of the draws about a mean within the bounds is good, or std is next to them."""
    found = random.normal(stage.mean, stage.std, size)
    for _ in range(200):
        bad = (found < stage.low) | (found > stage.high)
        if not bad.any():
            return found
        found[bad] = random.normal(stage.mean, stage.std, int(bad.sum()))
    return np.clip(found, stage.low, stage.high)


def _gamma(stage: Any, size: Shape, random: np.random.Generator) -> NDArray[np.float64]:
    return np.asarray(stage.delay + random.gamma(stage.shape, stage.scale, size))


def _lognormal(stage: Any, size: Shape, random: np.random.Generator) -> NDArray[np.float64]:
    return np.asarray(stage.delay + stage.median * random.lognormal(0.0, stage.sigma, size))


def _bernoulli(stage: Any, size: Shape, random: np.random.Generator) -> NDArray[np.float64]:
    return np.where(random.random(size) < stage.loss, math.nan, 0.0)


def _gilbert_elliott(stage: Any, size: Shape, random: np.random.Generator) -> NDArray[np.float64]:
    bad = np.zeros((size[0], size[2]), np.bool_)
    _turns(stage.p_GB, stage.p_BG, random.random(bad.shape), bad)
    return np.where(random.random(size) < np.where(bad, stage.loss_B, stage.loss_G)[:, None, :], math.nan, 0.0)


@compiled
def _turns(p_gb: float, p_bg: float, chance: NDArray[np.float64], bad: NDArray[np.bool_]) -> None:
    """Whether each channel is bad at each entry, (draws, channels); the first by the stationary probability."""
    both = p_gb + p_bg
    for c in range(bad.shape[1]):
        for n in range(bad.shape[0]):
            if n == 0:
                bad[n, c] = chance[n, c] * both < p_gb
            elif bad[n - 1, c]:
                bad[n, c] = chance[n, c] >= p_bg
            else:
                bad[n, c] = chance[n, c] < p_gb


# Models whose delay (s) of each entry is drawn; NaN: the entry is lost.
DRAWN: dict[str, Callable[[Any, Shape, np.random.Generator], NDArray[np.float64]]] = {
    "uniform": _uniform,
    "normal": _normal,
    "gamma": _gamma,
    "lognormal": _lognormal,
    "bernoulli": _bernoulli,
    "gilbert_elliott": _gilbert_elliott,
}


def draw(stage: Any, size: Shape, channels: Sequence[str], random: np.random.Generator) -> NDArray[np.int64]:
    """Delays in ns, LOST where an entry is lost; of `duplicate` 1 where it is copied."""
    if stage.model == "duplicate":
        return np.asarray(random.random(size) < stage.probability, np.int64)
    delay = _replayed(stage, size, channels) if stage.model == "trace" else DRAWN[stage.model](stage, size, random)
    lost = np.isnan(delay)
    times = np.rint(np.clip(np.where(lost, 0.0, delay), 0.0, LONGEST_S) * NANOSECONDS)
    return np.where(lost, LOST, times.astype(np.int64))


def _replayed(stage: Any, size: Shape, channels: Sequence[str]) -> NDArray[np.float64]:
    """A trace's delays; a channel that it does not know has none."""
    found = np.zeros(size)
    for c, name in enumerate(channels):
        own = stage.delays.get(name, [0.0]) if isinstance(stage.delays, dict) else stage.delays
        series = np.array([math.nan if delay is None else delay for delay in own], np.float64)
        found[:, :, c] = np.resize(series, size[0])[:, None]
    return found


def mean_delay(stages: Sequence[Any], names: Collection[str] | None = None) -> float:
    """Mean delay of a chain, s, where nothing is lost or waits for others; stages that start later add none.

    `names`: what the channel goes by, as stages name it in `channels`; None: one that all stages concern.
    """
    means: dict[str, Callable[[Any], float]] = {
        "constant": lambda s: s.delay,
        "uniform": lambda s: (s.low + s.high) / 2.0,
        "normal": lambda s: s.mean,
        "gamma": lambda s: s.delay + s.shape * s.scale,
        "lognormal": lambda s: s.delay + s.median * math.exp(s.sigma**2 / 2.0),
        "trace": _trace_mean,
    }
    total = 0.0
    for stage in stages:
        if stage.start > 0.0 or not (names is None or stage.channels is None or set(stage.channels) & set(names)):
            continue
        if stage.model in means:
            total += means[stage.model](stage)
        elif stage.model == "playout":
            total = max(total, stage.delay)
    return total


def _trace_mean(stage: Any) -> float:
    series = list(stage.delays.values()) if isinstance(stage.delays, dict) else [stage.delays]
    known = [delay for own in series for delay in own if delay is not None]
    return math.fsum(known) / len(known) if known else 0.0
