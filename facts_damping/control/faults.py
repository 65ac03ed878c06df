"""Faults of controllers in a fault campaign: wrong setpoints and corrupted networks; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from facts_damping import random_numbers
from facts_damping.compiling import compiled
from facts_damping.compiling.structs import Array, Float1, Float2, Struct
from facts_damping.parameters.faults import SIZED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.faults import ControllerFault

NONE, WRONG_SIGN, GAIN, STUCK, RANDOM, BANG_BANG, NAN, WEIGHTS, HUNG, DEAD = range(10)
KINDS = ("", "wrong_sign", "gain", "stuck", "random", "bang_bang", "nan", "weights", "hung", "dead")
FAULT = np.dtype(
    [("kind", "i8"), ("first", "i8"), ("end", "i8"), ("size", "f8")]
)  # `first`, `end`: ticks, `end` excluded
CHANCES = 1024  # normal random numbers of a controller's faults, used cyclically


class Faults(Struct):
    """Faults of all controllers; the first axis is the controller."""

    rows: Annotated[NDArray[Any], Array(FAULT, 2)]  # (controllers, most faults) of FAULT
    chance: Float2  # (controllers, CHANCES): normal random numbers; empty without faults


def faults(lists: Sequence[Sequence[ControllerFault]], frame_rate: int, seed: int) -> Faults:
    """Build the faults of all controllers, in order for each."""
    maximum = max(map(len, lists), default=0)
    rows = np.zeros((len(lists), maximum), FAULT)
    for c, listed in enumerate(lists):
        for row, f in zip(rows[c], listed, strict=False):
            row["kind"], row["size"] = KINDS.index(f.kind), SIZED.get(f.kind, 0.0) if f.size is None else f.size
            row["first"] = math.ceil(f.start * frame_rate)
            over = np.inf if f.duration is None else math.ceil((f.start + f.duration) * frame_rate)
            row["end"] = min(over, np.iinfo(np.int64).max)
    chance = random_numbers.standard_normal(np.random.default_rng((seed, 4)), (len(lists), CHANCES if maximum else 0))
    return Faults(rows, chance)


@compiled
def silent(of: Faults, c: int, tick: int) -> bool:
    """Whether a fault keeps controller c from issuing setpoints in a tick."""
    for i in range(of.rows.shape[1]):
        row = of.rows[c, i]
        if row.kind >= HUNG and row.first <= tick < row.end:
            return True
    return False


@compiled
def corrupt(of: Faults, c: int, tick: int, theta: Float1) -> None:
    """Disturb a network's parameters in the first tick of a `weights` fault."""
    for i in range(of.rows.shape[1]):
        row = of.rows[c, i]
        if row.kind == WEIGHTS and row.first == tick:
            for f in range(theta.size):
                theta[f] += row.size * of.chance[c, (tick + f) % CHANCES]


@compiled
def misbehave(of: Faults, c: int, tick: int, d: int, value: float, before: float, limit: float) -> float:
    """A setpoint with faults applied, p.u.; `before`: the previous setpoint; `limit`: of the device."""
    for i in range(of.rows.shape[1]):
        row = of.rows[c, i]
        if not row.first <= tick < row.end:
            continue
        if row.kind == WRONG_SIGN:
            value = -value
        elif row.kind == GAIN:
            value = min(max(row.size * value, -limit), limit)
        elif row.kind == STUCK:
            value = before
        elif row.kind == RANDOM:
            value = min(max(0.7 * limit * of.chance[c, (3 * tick + d) % CHANCES], -limit), limit)
        elif row.kind == BANG_BANG:
            value = limit if tick % 2 else -limit
        elif row.kind == NAN:
            value = math.nan
    return value
