"""The models of a link's stages, a row each: its code, what is drawn for it, and how much it delays on average.

What chance decides is drawn before a run: the n-th entry of a channel takes the n-th draw, from the beginning again
after the last one. So the link knows at once when an entry arrives, and a node and the in-process loop know the same.
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

    from facts_damping.link.draws import Shape

# What a stage does. Chains are filled up with stages of zeros, which act on nothing.
CONSTANT, DRAWN, DUPLICATE, IN_ORDER, WAIT, PLAYOUT, SPOOF, FREEZE, REPLAY, BIAS, SCALE, RAMP, NOISE, FLIP = range(14)
CHANCE = (DRAWN, DUPLICATE, FLIP)  # codes of stages that need draws
BITS, MOST_VALUES = 64, len(CHANNELS)  # of a value; of an entry


def _none(_stage: Any, so_far: float) -> float:
    return so_far


class StageKind(NamedTuple):
    """A row: the code that `chain.traverse` branches on, and what follows from a stage's fields."""

    code: int
    draw: Callable[[Any, Shape, Sequence[str], np.random.Generator], NDArray[np.float64]] | None = None
    mean: Callable[[Any, float], float] = _none  # mean delay of a chain with it behind what is delayed so far, s
    time: str = ""  # its field that is a time
    number: str = ""  # its field that is another number


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


def draw(stage: Any, size: Shape, channels: Sequence[str], random: np.random.Generator) -> NDArray[np.int64]:
    """Delays in ns, LOST where an entry is lost; of `duplicate` 1 where it is copied.

    Of `flip` 1 + the bit that is turned over, counted through all values of an entry, 0: none.
    """
    drawn = MODELS[stage.model].draw
    if stage.model == "flip":
        turned = random_numbers.random(random, size) < stage.probability
        bit = random_numbers.integers(random, BITS * MOST_VALUES, size)
        return np.asarray(np.where(turned, 1 + bit, 0), np.int64)
    if drawn is None:
        return np.asarray(random_numbers.random(random, size) < stage.probability, np.int64)
    delay = drawn(stage, size, channels, random)
    lost = np.isnan(delay)
    times = np.rint(np.clip(np.where(lost, 0.0, delay), 0.0, LONGEST_S) * NANOSECONDS)
    return np.where(lost, LOST, times.astype(np.int64))


def mean_delay(stages: Sequence[Any], names: Collection[str] | None = None) -> float:
    """Mean delay of a chain, s, where nothing is lost or waits for others; stages that start later add none.

    `names`: what the channel goes by, as stages name it in `channels`; None: one that all stages concern.
    """
    total = 0.0
    for stage in stages:
        if stage.start <= 0.0 and (names is None or stage.channels is None or set(stage.channels) & set(names)):
            total = MODELS[stage.model].mean(stage, total)
    return total
