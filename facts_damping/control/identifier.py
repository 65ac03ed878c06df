"""Identifiers: networks that predict a controller's signals and thus estimate the plant's Jacobian; compiled.

    y_I(k) = f_I(y(k-h), mean u(k-h-d .. k-1-d)),  f_I += -eta_I (y_I - y) dy_I/df_I + momentum,  J = dy_I/du

Sources: (5.1) and (6.7), which have h = 1 and pair y with u of the same frame; (5.12) and (5.6). h is the horizon in
frames, d the known delay from measurement to actuation: a setpoint is paired with the measurement used for it. An
identifier with a span of b frames also uses y(k-h-b), which shows a signal's trend. Signals are normalised by the
controller's scales, setpoints by the devices' limits.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.control.identifier_model import (
    Identified,
    Identifiers,
    IdentifierState,
    past_values,
    predictor_network,
    start,
)
from facts_damping.control.inputs import UNSET, Wiring, compute_signals, ingest, inputs
from facts_damping.control.prediction import fill, frame_before, look_ahead
from facts_damping.control.table import SETTINGS
from facts_damping.neurofuzzy.learning import Learner, Rule, infer, learn, learners
from facts_damping.neurofuzzy.network import Network, by_inputs, shape_of
from facts_damping.signals import NANOSECONDS, Deliveries, Estimates, Setpoints, to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence


SPARE = 4  # frames beyond the loop's delay for which setpoints are kept


def identifiers(rows: Sequence[Identified], wiring: Wiring) -> tuple[Identifiers, IdentifierState]:
    """Build the identifiers of a run."""
    n, maximum = len(rows), max([len(row.devices) for row in rows], default=0)
    outputs = max([len(row.signals) for row in rows], default=0)
    span = np.array([int(row.settings["identifier_span"][0]) for row in rows], np.int64)
    order = np.array([past_values(frames) for frames in span], np.int64)
    nets = [
        predictor_network(row.kind, len(row.signals), len(row.devices), o) for row, o in zip(rows, order, strict=True)
    ]
    starts = [start(net, row) if row.weights is None else row.weights for net, row in zip(nets, rows, strict=True)]
    receivers, held = inputs([row.signals for row in rows], wiring.signals, wiring.pmus, wiring.nominal)
    loop_delay_ns = np.array([to_ns(float(row.settings["loop_delay"][0])) for row in rows], np.int64)
    horizon = np.array([int(row.settings["identifier_horizon"][0]) for row in rows], np.int64)
    ahead_ns = np.where([row.predicts for row in rows], loop_delay_ns, UNSET)
    back = int((horizon + span).max(initial=1))
    loop_delay = int(loop_delay_ns.max(initial=0)) * wiring.frame_rate // NANOSECONDS
    depth = loop_delay + back + SPARE
    ids = Identifiers(
        controller=np.array([row.controller for row in rows], np.int64),
        settings=np.zeros((n, max(outputs, maximum)), SETTINGS),
        shape=np.array(nets, np.int64).reshape(n, len(Network._fields)),
        inputs=receivers,
        device=np.full((n, maximum), UNSET, np.int64),
        limit=np.ones((n, maximum)),
        loop_delay_ns=loop_delay_ns,
        horizon=horizon,
        order=order,
        span=span,
        ahead_ns=ahead_ns,
        period_ns=np.full(n, NANOSECONDS // wiring.frame_rate, np.int64),
    )
    state = IdentifierState(
        held=held,
        learner=learners(nets, starts),
        past=np.zeros((n, back + 1, outputs)),
        past_ns=np.full((n, back + 1), UNSET, np.int64),
        newest=np.zeros(n, np.int64),
        given_ns=np.full((n, maximum, depth), UNSET, np.int64),
        given=np.zeros((n, maximum, depth)),
        at=np.zeros((n, maximum), np.int64),
        deviation=np.zeros((n, outputs)),
        curvature=np.ones((n, outputs)),
        lyapunov=np.zeros((n, 2)),
        prediction=np.full((n, outputs), np.nan),
        error=np.full((n, outputs), np.nan),
        peak=np.zeros((n, outputs)),
        path=np.zeros((n, back + loop_delay + SPARE, outputs)),
        change=np.full((n, outputs), np.nan),
        jacobian=np.full((n, outputs, maximum), np.nan),
    )
    for i, row in enumerate(rows):
        size = min(ids.settings.shape[1], len(row.settings))
        ids.settings[i, :size] = row.settings[:size]
        ids.device[i, : len(row.devices)] = row.devices
        ids.limit[i, : len(row.devices)] = row.limits
        _first(ids, state, i)
    return ids, state


@compiled
def _evaluate(net: Network, learner: Learner, ids: Identifiers, state: IdentifierState, n: int) -> None:
    """Compute prediction and Jacobian at `learner.x`."""
    first = ids.order[n] * net.outputs
    infer(net, learner)
    by_inputs(net, learner.theta, learner.passed)
    for i in range(net.outputs):
        for d in range(net.inputs - first):
            by_u = learner.passed.by_input[i, first + d]
            state.jacobian[n, i, d] = by_u * ids.settings[n, i].scale / ids.limit[n, d]


@entry_point
def _first(ids: Identifiers, state: IdentifierState, n: int) -> None:
    """Compute an identifier's initial Jacobian, at rest."""
    net = shape_of(ids.shape[n])
    _evaluate(net, state.learner.each[n], ids, state, n)


@entry_point
def store_setpoints(ids: Identifiers, state: IdentifierState, n: int, issued: Setpoints, count: int) -> None:
    """Store those of `count` issued setpoints that are for identifier n's devices."""
    for i in range(count):
        for d in range(ids.device.shape[1]):
            if issued[i].device == ids.device[n, d]:
                at = (state.at[n, d] + 1) % state.given.shape[2]
                state.at[n, d] = at
                state.given_ns[n, d, at] = issued[i].measured_ns
                state.given[n, d, at] = issued[i].value


@compiled
def _learn(ids: Identifiers, state: IdentifierState, n: int) -> None:
    """Predict the newest frame from past frames and setpoints, and learn from the error.

    Skipped if a frame or setpoint is missing.
    """
    net, s, now = shape_of(ids.shape[n]), ids.settings[n], state.held.newest_ns[n]
    learner, p = state.learner.each[n], shape_of(ids.shape[n]).outputs
    elapsed = 0
    for k in range(ids.order[n]):
        before = frame_before(ids, state, n, now, ids.horizon[n] + k * ids.span[n])
        if before == UNSET:
            return
        elapsed = elapsed if k else now - state.past_ns[n, before]
        for j in range(p):
            learner.x[k * p + j] = state.past[n, before, j] / s[j].scale
    fill(learner.x[ids.order[n] * p : net.inputs], ids, state, n, now, elapsed)
    _evaluate(net, learner, ids, state, n)
    for j in range(net.outputs):
        state.prediction[n, j] = learner.passed.output[j] * s[j].scale
        state.error[n, j] = state.prediction[n, j] - state.held.signal[n, j]
        state.deviation[n, j] = -state.error[n, j] / s[j].scale
    g = s[0]
    rule = Rule(g.identifier_rate, g.identifier_eta, g.identifier_momentum, g.identifier_leakage, g.clip, g.projection)
    learn(net, learner, rule, state.deviation[n], state.curvature[n])
    now_is = then = 0.0
    for j in range(net.outputs):
        now_is += 0.5 * state.deviation[n, j] ** 2
        then += 0.5 * (state.deviation[n, j] - learner.moved[j]) ** 2
    state.lyapunov[n, 0], state.lyapunov[n, 1] = now_is, now_is - then


@entry_point
def identify(ids: Identifiers, state: IdentifierState, n: int, delivered: Deliveries, count: int) -> None:
    """Run a tick of identifier n: process `count` delivered entries, learn once per new frame that follows the last."""
    s = ids.settings[n, 0]
    i = 0
    while i < count:
        arrival = delivered[i].arrival_ns
        i = ingest(ids.inputs, state.held, n, delivered, i, count)
        if compute_signals(ids.inputs, state.held, n) < 0:
            continue
        now = state.held.newest_ns[n]
        if s.stale <= 0.0 or (arrival - now) * 1e-9 <= s.stale:
            _learn(ids, state, n)
        at = (state.newest[n] + 1) % state.past_ns.shape[1]
        state.newest[n], state.past_ns[n, at] = at, now
        for j in range(state.past.shape[2]):
            state.past[n, at, j] = state.held.signal[n, j]
            state.peak[n, j] = max(state.peak[n, j], abs(state.held.signal[n, j]))
        if ids.ahead_ns[n] != UNSET:
            look_ahead(ids, state, n, shape_of(ids.shape[n]), state.learner.each[n])


@entry_point
def write_estimates(ids: Identifiers, state: IdentifierState, n: int, tick: int, out: Estimates, first: int) -> int:
    """Write the ESTIMATE rows of identifier n to `out` from `first` on; returns the index after the last."""
    net = shape_of(ids.shape[n])
    for i in range(net.outputs):
        for d in range(net.inputs - ids.order[n] * net.outputs):
            row = out[first]
            row.tick = tick
            row.controller = ids.controller[n]
            row.signal = i
            row.device = ids.device[n, d]
            row.measured_ns = state.held.newest_ns[n]
            row.jacobian = state.jacobian[n, i, d]
            row.prediction = state.prediction[n, i]
            row.error = state.error[n, i]
            row.ahead = ids.ahead_ns[n] * 1e-9 if ids.ahead_ns[n] != UNSET else math.nan
            row.change = state.change[n, i]
            first += 1
    return first
