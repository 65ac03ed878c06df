"""The models of a link's stages, one row each: code, function for random draws, mean delay.

Random numbers are drawn before a run: the n-th entry of a channel uses the n-th draw, cyclically. The arrival time of
an entry is therefore known when it is sent, and is the same in a node and in the in-process loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping import random_numbers
from facts_damping.elementary import exp
from facts_damping.extensions import rows
from facts_damping.link import draws
from facts_damping.parameters.stages import LONGEST_S
from facts_damping.signals import CHANNELS, LOST, NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Int3
    from facts_damping.link.draws import Shape

# Codes of stages. Chains are padded with rows of zeros, which have no effect.
CONSTANT, DRAWN, DUPLICATE, IN_ORDER, WAIT, PLAYOUT, SPOOF, FREEZE, REPLAY, BIAS, SCALE, RAMP, NOISE, FLIP = range(14)
CHANCE = (DRAWN, DUPLICATE, FLIP)  # stages that need draws
BITS, MAX_VALUES = 64, len(CHANNELS)  # bits of a value; most values of an entry


def _none(_stage: Any, so_far: float) -> float:
    return so_far


class StageKind(NamedTuple):
    """A row: the code that `chain.traverse` branches on, and functions and names of a stage's fields."""

    code: int
    draw: Callable[[Any, Shape, Sequence[str], np.random.Generator], NDArray[np.float64]] | None = None
    mean: Callable[[Any, float], float] = _none  # (stage, mean delay before it, s) to mean delay after it, s
    time: str = ""  # name of its field that is a time
    number: str = ""  # name of its other numeric field


MODELS = {
    "constant": StageKind(CONSTANT, None, lambda s, so_far: so_far + s.delay, time="delay"),
    "uniform": StageKind(DRAWN, draws.uniform, lambda s, so_far: so_far + (s.low + s.high) / 2.0),
    "normal": StageKind(DRAWN, draws.normal, lambda s, so_far: so_far + s.mean),
    "gamma": StageKind(DRAWN, draws.gamma, lambda s, so_far: so_far + (s.delay + s.shape * s.scale)),
    "lognormal": StageKind(
        DRAWN, draws.lognormal, lambda s, so_far: so_far + (s.delay + s.median * exp(s.sigma * s.sigma / 2.0))
    ),
    "trace": StageKind(DRAWN, draws.trace, lambda s, so_far: so_far + draws.trace_mean(s)),
    "bernoulli": StageKind(DRAWN, draws.bernoulli),
    "gilbert_elliott": StageKind(DRAWN, draws.gilbert_elliott),
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
    """Draw delays in ns, with LOST for lost entries; for `duplicate` 1 if an entry is copied.

    For `flip` 1 + number of the inverted bit, counted over all values of an entry; 0: none.
    """
    drawn = MODELS[stage.model].draw
    if stage.model == "flip":
        turned = random_numbers.random(random, size) < stage.probability
        bit = random_numbers.integers(random, BITS * MAX_VALUES, size)
        return np.asarray(np.where(turned, 1 + bit, 0), np.int64)
    if drawn is None:
        return np.asarray(random_numbers.random(random, size) < stage.probability, np.int64)
    delay = drawn(stage, size, channels, random)
    lost = np.isnan(delay)
    times = np.rint(np.clip(np.where(lost, 0.0, delay), 0.0, LONGEST_S) * NANOSECONDS)
    return np.where(lost, LOST, times.astype(np.int64))


def mean_delay(stages: Sequence[Any], names: Collection[str] | None = None) -> float:
    """Mean delay of a chain, s, without losses and waits; stages that start during the run are ignored.

    `names`: names of the channel in the stages' `channels`; None: a channel that all stages act on.
    """
    total = 0.0
    for stage in stages:
        if stage.start <= 0.0 and (names is None or stage.channels is None or set(stage.channels) & set(names)):
            total = MODELS[stage.model].mean(stage, total)
    return total
