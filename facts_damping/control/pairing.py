"""Pairs frames and setpoints for an identifier, by the measurement used for each setpoint; compiled."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.control.inputs import UNSET

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.control.identifier_model import Identifiers, IdentifierState


@compiled
def frame_before(ids: Identifiers, state: IdentifierState, n: int, now: int, frames: int) -> int:
    """Index of the frame `frames` before `now`, to within half a frame; UNSET if it is not stored."""
    period = ids.period_ns[n]
    for at in range(state.past_ns.shape[1]):
        then = state.past_ns[n, at]
        if then != UNSET and abs(now - then - frames * period) < period // 2:
            return at
    return UNSET


@compiled
def between(ids: Identifiers, state: IdentifierState, n: int, now: int, frames: int, into: Float1) -> None:
    """Signals `frames` before `now`, p.u.; interpolated linearly if that frame is missing, NaN if impossible."""
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
            fraction = (wanted - state.past_ns[n, low]) / (state.past_ns[n, high] - state.past_ns[n, low])
            into[j] = state.past[n, low, j] + fraction * (state.past[n, high, j] - state.past[n, low, j])


@compiled
def fill(into: Float1, ids: Identifiers, state: IdentifierState, n: int, now: int, elapsed: int) -> None:
    """Mean setpoint of each device in force over the `elapsed` ns before `now`; 1 = the device's limit.

    It is sampled at the middle of each frame.
    """
    frames = ids.horizon[n]
    for d in range(into.size):
        total = 0.0
        for j in range(frames):
            total += _given(state, n, d, now - (2 * j + 1) * elapsed // (2 * frames) - ids.loop_delay_ns[n])
        into[d] = total / frames / ids.limit[n, d]


@compiled
def _given(state: IdentifierState, n: int, d: int, until_ns: int) -> float:
    """Newest setpoint of device d based on a measurement not after `until_ns`, p.u.; 0 before the first."""
    size = state.given.shape[2]
    for back in range(size):
        at = (state.at[n, d] - back) % size
        if state.given_ns[n, d, at] != UNSET and state.given_ns[n, d, at] <= until_ns:
            return state.given[n, d, at]  # type: ignore[no-any-return]
    return 0.0
