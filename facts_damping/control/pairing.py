"""Which frames and setpoints an identifier pairs: setpoints by the measurement that they rest on; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.control.inputs import UNSET

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.control.identifier_model import Identifiers, IdentifierState


@compiled
def frame_before(ids: Identifiers, state: IdentifierState, n: int, now: int, frames: int) -> int:
    """Place of the frame that lies `frames` before `now`, to half a frame; UNSET where it is not kept."""
    period = ids.period_ns[n]
    for at in range(state.past_ns.shape[1]):
        then = state.past_ns[n, at]
        if then != UNSET and abs(now - then - frames * period) < period // 2:
            return at
    return UNSET


@compiled
def between(ids: Identifiers, state: IdentifierState, n: int, now: int, frames: int, into: NDArray[np.float64]) -> None:
    """The signals `frames` before `now`, p.u.; where that frame is missing, on the line between others, or NaN."""
    at = frame_before(ids, state, n, now, frames)
    wanted, low, high = now - frames * ids.period_ns[n], at, at
    for i in range(state.past_ns.shape[1] if at == UNSET else 0):
        then = state.past_ns[n, i]
        if then != UNSET and then < wanted and (low == UNSET or then > state.past_ns[n, low]):
            low = i
        if then > wanted and (high == UNSET or then < state.past_ns[n, high]):
            high = i
    for j in range(into.size):
        if UNSET in (low, high):
            into[j] = math.nan
        elif low == high:
            into[j] = state.past[n, low, j]
        else:
            share = (wanted - state.past_ns[n, low]) / (state.past_ns[n, high] - state.past_ns[n, low])
            into[j] = state.past[n, low, j] + share * (state.past[n, high, j] - state.past[n, low, j])


@compiled
def fill(into: NDArray[np.float64], ids: Identifiers, state: IdentifierState, n: int, now: int, elapsed: int) -> None:
    """The setpoints in force from `elapsed` before `now` on, ns, one a device: their means, 1 = the device's limit."""
    for d in range(into.size):
        into[d] = _mean(ids, state, n, d, now, elapsed) / ids.limit[n, d]


@compiled
def _mean(ids: Identifiers, state: IdentifierState, n: int, d: int, now: int, elapsed: int) -> float:
    """Mean of the setpoints of device d in force from `elapsed` before `now` on: those at the middle of each frame."""
    frames, total = ids.horizon[n], 0.0
    for j in range(frames):
        total += _given(state, n, d, now - (2 * j + 1) * elapsed // (2 * frames) - ids.loop_delay_ns[n])
    return total / frames  # type: ignore[no-any-return]


@compiled
def _given(state: IdentifierState, n: int, d: int, until_ns: int) -> float:
    """The newest setpoint of device d that rests on a measurement not after `until_ns`; 0 before the first."""
    size = state.given.shape[2]
    for back in range(size):
        at = (state.at[n, d] - back) % size
        if state.given_ns[n, d, at] != UNSET and state.given_ns[n, d, at] <= until_ns:
            return state.given[n, d, at]  # type: ignore[no-any-return]
    return 0.0
