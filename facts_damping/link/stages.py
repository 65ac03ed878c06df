"""The models of a link's stages, one row each: code, function for random draws, mean delay.

Random numbers are drawn before a run: the n-th entry of a channel uses the n-th draw, cyclically. The arrival time of
an entry is therefore known when it is sent, and is the same in a node and in the in-process loop.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping import random_numbers
from facts_damping.compiling import entry_point
from facts_damping.compiling.structs import Bool2, Float2, Float3, Int3
from facts_damping.elementary import exp
from facts_damping.extensions import rows
from facts_damping.parameters.stages import LONGEST_S
from facts_damping.signals import CHANNELS, NANOSECONDS, NEVER

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Int3

    Shape = tuple[int, int, int]  # (draws, copies, channels)

# Codes of stages. Chains are padded with rows of zeros, which have no effect.
CONSTANT, DRAWN, DUPLICATE, IN_ORDER, WAIT, PLAYOUT, SPOOF, FREEZE, REPLAY, BIAS, SCALE, RAMP, NOISE, FLIP = range(14)
CHANCE = (DRAWN, DUPLICATE, FLIP)  # stages that need draws
DISTURBING = (SPOOF, FREEZE, REPLAY, BIAS, SCALE, RAMP, NOISE, FLIP)  # they change values or time stamps
BITS, MAX_VALUES = 64, len(CHANNELS)  # bits of a value; most values of an entry


# Functions that draw a delay for each entry of each channel, (draws, copies, channels), s; NaN: the entry is lost.


def uniform(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """Uniform distribution between two bounds."""
    return random_numbers.uniform(random, stage.low, stage.high, size)


def normal(stage: Any, size: Shape, _channels: Sequence[str], random: np.random.Generator) -> Float3:
    """Truncated normal distribution: draws outside the bounds are repeated, after 200 rounds clipped."""
    draws = random_numbers.normal(random, stage.mean, stage.std, size)
    for _ in range(200):
        bad = (draws < stage.low) | (draws > stage.high)
        if not bad.any():
            return draws
        draws[bad] = random_numbers.normal(random, stage.mean, stage.std, int(bad.sum()))
    return np.clip(draws, stage.low, stage.high)


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
    delays = np.zeros(size)
    for c, name in enumerate(channels):
        channel_delays = stage.delays.get(name, [0.0]) if isinstance(stage.delays, dict) else stage.delays
        series = np.array([math.nan if delay is None else delay for delay in channel_delays], np.float64)
        delays[:, :, c] = np.resize(series, size[0])[:, None]
    return delays


def trace_mean(stage: Any) -> float:
    """Mean delay of a trace, s."""
    series = list(stage.delays.values()) if isinstance(stage.delays, dict) else [stage.delays]
    known = [delay for delays in series for delay in delays if delay is not None]
    return math.fsum(known) / len(known) if known else 0.0


class StageKind(NamedTuple):
    """A row: the code that `chain.traverse` branches on, and functions and names of a stage's fields."""

    code: int
    draw: Callable[[Any, Shape, Sequence[str], np.random.Generator], NDArray[np.float64]] | None = None
    mean: Callable[[Any, float], float] = lambda _stage, so_far: (
        so_far
    )  # (stage, mean delay before it, s) to mean delay after it, s
    time: str = ""  # name of its field that is a time
    number: str = ""  # name of its other numeric field


MODELS = {
    "constant": StageKind(CONSTANT, None, lambda s, so_far: so_far + s.delay, time="delay"),
    "uniform": StageKind(DRAWN, uniform, lambda s, so_far: so_far + (s.low + s.high) / 2.0),
    "normal": StageKind(DRAWN, normal, lambda s, so_far: so_far + s.mean),
    "gamma": StageKind(DRAWN, gamma, lambda s, so_far: so_far + (s.delay + s.shape * s.scale)),
    "lognormal": StageKind(
        DRAWN, lognormal, lambda s, so_far: so_far + (s.delay + s.median * exp(s.sigma * s.sigma / 2.0))
    ),
    "trace": StageKind(DRAWN, trace, lambda s, so_far: so_far + trace_mean(s)),
    "bernoulli": StageKind(DRAWN, bernoulli),
    "gilbert_elliott": StageKind(DRAWN, gilbert_elliott),
    "duplicate": StageKind(DUPLICATE),
    "in_order": StageKind(IN_ORDER),
    "wait": StageKind(WAIT, time="wait"),
    "playout": StageKind(PLAYOUT, None, lambda s, so_far: max(so_far, s.delay), time="delay"),
    "spoof": StageKind(SPOOF, time="offset"),
    "freeze": StageKind(FREEZE),
    "replay": StageKind(REPLAY),
    "bias": StageKind(BIAS, number="bias"),
    "scale": StageKind(SCALE, number="factor"),
    "ramp": StageKind(RAMP, number="rate"),
    "noise": StageKind(NOISE, number="std"),
    "flip": StageKind(FLIP),
}
MODELS |= rows("stage_kinds", StageKind, MODELS)


def draw(stage: Any, size: Shape, channels: Sequence[str], random: np.random.Generator) -> Int3:
    """Draw delays in ns, with NEVER for lost entries; for `duplicate` 1 if an entry is copied.

    For `flip` 1 + number of the inverted bit, counted over all values of an entry; 0: none.
    """
    sample = MODELS[stage.model].draw
    if stage.model == "flip":
        inverted = random_numbers.random(random, size) < stage.probability
        bit = random_numbers.integers(random, BITS * MAX_VALUES, size)
        return np.asarray(np.where(inverted, 1 + bit, 0), np.int64)
    if sample is None:
        return np.asarray(random_numbers.random(random, size) < stage.probability, np.int64)
    delay = sample(stage, size, channels, random)
    lost = np.isnan(delay)
    times = np.rint(np.clip(np.where(lost, 0.0, delay), 0.0, LONGEST_S) * NANOSECONDS)
    return np.where(lost, NEVER, times.astype(np.int64))


def mean_delay(stages: Sequence[Any], names: Collection[str] | None = None) -> float:
    """Mean delay of a chain, s, without losses and waits; stages that start during the run are ignored.

    `names`: names of the channel in the stages' `channels`; None: a channel that all stages act on.
    """
    total = 0.0
    for stage in stages:
        if stage.start <= 0.0 and (names is None or stage.channels is None or set(stage.channels) & set(names)):
            total = MODELS[stage.model].mean(stage, total)
    return total
