"""Functions that draw a delay for each entry of each channel, at random or from a measured series.

Arguments: stage, shape (draws, copies, channels), names of channels, random generator. Each returns delays in s;
NaN: the entry is lost.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping import random_numbers
from facts_damping.compiling import entry_point
from facts_damping.compiling.structs import Bool2, Float2, Float3

if TYPE_CHECKING:
    from collections.abc import Sequence

    Shape = tuple[int, int, int]  # (draws, copies, channels)


def uniform(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """Uniform distribution between two bounds."""
    return random_numbers.uniform(random, stage.low, stage.high, size)


def normal(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """Truncated normal distribution: draws outside the bounds are repeated, after 200 rounds clipped."""
    found = random_numbers.normal(random, stage.mean, stage.std, size)
    for _ in range(200):
        bad = (found < stage.low) | (found > stage.high)
        if not bad.any():
            return found
        found[bad] = random_numbers.normal(random, stage.mean, stage.std, int(bad.sum()))
    return np.clip(found, stage.low, stage.high)


def gamma(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """A constant delay plus a gamma distribution."""
    return stage.delay + random_numbers.gamma(random, stage.shape, stage.scale, size)  # type: ignore[no-any-return]


def lognormal(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """A constant delay plus a lognormal distribution."""
    return stage.delay + stage.median * random_numbers.lognormal(random, 0.0, stage.sigma, size)  # type: ignore[no-any-return]


def bernoulli(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """Independent loss of each entry."""
    return np.where(random_numbers.random(random, size) < stage.loss, math.nan, 0.0)


def gilbert_elliott(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """Losses of a channel that alternates between a good and a bad state (Gilbert 1960, Elliott 1963)."""
    bad = np.zeros((size[0], size[2]), np.bool_)
    _turns(stage.p_GB, stage.p_BG, random_numbers.random(random, bad.shape), bad)
    return np.where(
        random_numbers.random(random, size) < np.where(bad, stage.loss_B, stage.loss_G)[:, None, :], math.nan, 0.0
    )


@entry_point
def _turns(p_gb: float, p_bg: float, chance: Float2, bad: Bool2) -> None:
    """Compute whether each channel is bad at each entry, (draws, channels); starts with the stationary probability."""
    both = p_gb + p_bg
    for c in range(bad.shape[1]):
        for n in range(bad.shape[0]):
            if n == 0:
                bad[n, c] = chance[n, c] * both < p_gb
            elif bad[n - 1, c]:
                bad[n, c] = chance[n, c] >= p_bg
            else:
                bad[n, c] = chance[n, c] < p_gb


def trace(stage: Any, size: Shape, channels: Sequence[str], _random: np.random.Generator) -> Float3:
    """Delays from a trace; zero for channels that the trace lacks."""
    found = np.zeros(size)
    for c, name in enumerate(channels):
        own = stage.delays.get(name, [0.0]) if isinstance(stage.delays, dict) else stage.delays
        series = np.array([math.nan if delay is None else delay for delay in own], np.float64)
        found[:, :, c] = np.resize(series, size[0])[:, None]
    return found


def trace_mean(stage: Any) -> float:
    """Mean delay of a trace, s."""
    series = list(stage.delays.values()) if isinstance(stage.delays, dict) else [stage.delays]
    known = [delay for own in series for delay in own if delay is not None]
    return math.fsum(known) / len(known) if known else 0.0
