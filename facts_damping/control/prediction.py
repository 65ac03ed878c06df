"""Prediction of signals: an identifier iterated from the newest frame over the known delay; compiled.

An identifier pairs frames and setpoints by the measurement used for each setpoint (`frame_before`, `fill`).

    y_p(k+i) = f_I(y_p(k+i-h), y_p(k+i-h-b), mean u(k+i-h-d .. k+i-1-d)),  i = 1, 2 ..;  y_p(k+i) = y(k+i) for i <= 0
    c(k) = y_p(k+1+d) - y_p(k+1)

y(k-h-b) is used if the identifier has a span of b frames. The controller receives c at the next frame, k + 1, and acts
on y(k+1) + c(k): the signals at the time when its setpoint takes effect. The measurement thus corrects the error of the
first frame, and without delay nothing is added. Setpoints issued but not yet in force are known; that of frame k is
not, and the one before is used in its place.

Prediction over a network's delay: G.-P. Liu, Y. Xia, J. Chen, D. Rees, W. Hu, Networked Predictive Control of
Systems With Random Network Delays in Both Forward and Feedback Channels, IEEE Trans. Industrial Electronics 54(3),
2007. With a model identified online, for interarea oscillations: W. Yao, L. Jiang, J. Fang, J. Wen, S. Wang, Damping of
Inter-Area Low Frequency Oscillation Using an Adaptive Wide-Area Damping Controller, J. Electrical Engineering and
Technology 9(1), 2014.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.control.inputs import UNSET
from facts_damping.neurofuzzy.network import FLOOR, Network, forward

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1
    from facts_damping.control.identifier_model import Identifiers, IdentifierState
    from facts_damping.neurofuzzy.learning import Learner


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


FARTHEST = 10.0  # times the largest measured value: a prediction beyond is discarded


@compiled
def look_ahead(ids: Identifiers, state: IdentifierState, n: int, net: Network, learner: Learner) -> None:
    """Write the signals' change over the delay, from the frame after the newest on, p.u., to `state.change[n]`.

    NaN if frames are missing, no rule fires, or a prediction is implausible. Between two frames the change is
    interpolated linearly.
    """
    now, period, path = state.held.newest_ns[n], ids.period_ns[n], state.path[n]
    back, frames = ids.horizon[n] + ids.span[n], ids.ahead_ns[n] // period
    part = (ids.ahead_ns[n] - frames * period) / period
    for j in range(net.outputs):
        state.change[n, j] = math.nan
    for i in range(back):
        between(ids, state, n, now, back - 1 - i, path[i, : net.outputs])
    last = back + frames + (1 if part > 0.0 else 0)
    for i in range(back, last + 1):
        if not _next(ids, state, n, net, learner, i, now + (i - back + 1) * period):
            return
    for j in range(net.outputs):
        step = path[last, j] - path[back + frames, j]
        state.change[n, j] = path[back + frames, j] + part * step - path[back, j]


@compiled
def _next(
    ids: Identifiers, state: IdentifierState, n: int, net: Network, learner: Learner, i: int, time_ns: int
) -> bool:
    """Compute row i of the path, the frame at `time_ns`; returns False if that is impossible."""
    s, order, path = ids.settings[n], ids.order[n], state.path[n]
    for k in range(order):
        for j in range(net.outputs):
            learner.x[k * net.outputs + j] = path[i - ids.horizon[n] - k * ids.span[n], j] / s[j].scale
    fill(learner.x[order * net.outputs : net.inputs], ids, state, n, time_ns, ids.horizon[n] * ids.period_ns[n])
    forward(net, learner.theta, learner.x, learner.passed)
    for j in range(net.outputs):
        path[i, j] = learner.passed.output[j] * s[j].scale
        if not (learner.passed.total[j] > FLOOR and abs(path[i, j]) <= FARTHEST * state.peak[n, j]):
            return False
    return True
