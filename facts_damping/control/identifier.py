"""Identifiers: networks that predict a controller's signals some frames ahead, and so the plant's Jacobian; compiled.

    y_I(k) = f_I(y(k-h), mean u(k-h-d .. k-1-d)),  f_I += -eta_I (y_I - y) dy_I/df_I + momentum,  J = dy_I/du

(5.1) and (6.7), which have h = 1 and pair y with u of the same frame, (5.12) and (5.6). d is the known delay from
measurement to actuation: setpoints are paired by the measurement that they rest on. One with a span of b frames is
given y(k-h-b), too, and so knows where a signal goes. All is normalised by the controller's scales and the devices'
limits.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled, inner
from facts_damping.control.inputs import UNSET, Held, Inputs, form, inputs, take
from facts_damping.control.pairing import fill, frame_before
from facts_damping.control.prediction import look_ahead
from facts_damping.control.table import SETTINGS
from facts_damping.neurofuzzy.learning import Learner, Rule, infer, learn, learners, one
from facts_damping.neurofuzzy.network import Network, by_inputs, network, shape_of
from facts_damping.neurofuzzy.start import Start, initial, slots
from facts_damping.neurofuzzy.table import IDENTIFIERS, MIMO_FORM
from facts_damping.signals import NANOSECONDS, to_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.control.known import Known
    from facts_damping.parameters.system import Signal

WIDTH = 1.0  # s of the memberships at the start
SPREAD = 0.5  # memberships at -0.5 and 0.5, where the consequents hold the linear plant
DILATION = 5.0  # nu of the wavelets at the start
FLAT = 1e-9  # of phasors' largest extent: what extends less in another direction is round-off
SPARE = 4  # frames, beyond the lag, for which setpoints are kept


class Identified(NamedTuple):
    """What an identifier belongs to: the controller's place, its settings, signals, devices and their limits."""

    controller: int
    settings: NDArray[Any]  # (signals or devices,) of SETTINGS
    kind: str  # a row of IDENTIFIERS
    signals: Sequence[str]
    devices: Sequence[int]
    limits: Sequence[float]  # p.u.
    known: Known
    weights: NDArray[np.float64] | None  # parameters to start from; none: symmetric rules
    predicts: bool = False  # the controller acts on signals ahead


class Identifiers(NamedTuple):
    """Frozen parameters of all identifiers of a run; the first axis is the identifier."""

    controller: NDArray[np.int64]
    settings: NDArray[Any]  # (identifiers, most signals or devices) of SETTINGS
    shape: NDArray[np.int64]  # (identifiers, fields of Network)
    inputs: Inputs
    device: NDArray[np.int64]  # (identifiers, most devices); UNSET beyond its own
    limit: NDArray[np.float64]  # (identifiers, most devices), p.u.
    lag_ns: NDArray[np.int64]
    horizon: NDArray[np.int64]  # frames
    order: NDArray[np.int64]  # how many past values of each signal it is given
    span: NDArray[np.int64]  # frames from one of them to the next
    ahead_ns: NDArray[np.int64]  # how far it predicts; UNSET: not at all
    period_ns: NDArray[np.int64]


class IdentifierState(NamedTuple):
    """State of all identifiers; the first axis is the identifier."""

    held: Held
    learner: Learner
    past: NDArray[np.float64]  # (identifiers, kept, most signals), of the newest frames, a ring, p.u.
    past_ns: NDArray[np.int64]  # (identifiers, kept): their times
    newest: NDArray[np.int64]  # (identifiers,): place of the newest
    given_ns: NDArray[np.int64]  # (identifiers, most devices, kept): what the newest setpoints rest on, a ring
    given: NDArray[np.float64]  # the same shape: their values, p.u.
    at: NDArray[np.int64]  # (identifiers, most devices): place of the newest
    deviation: NDArray[np.float64]  # (identifiers, most signals): measurement less prediction, normalised
    curvature: NDArray[np.float64]  # (identifiers, most signals): ones
    lyapunov: NDArray[np.float64]  # (identifiers, 2): half the squared error that taught last, and its fall by the step
    prediction: NDArray[np.float64]  # (identifiers, most signals), p.u.; NaN: none yet
    error: NDArray[np.float64]  # (identifiers, most signals), prediction less measurement, p.u.; NaN: none yet
    peak: NDArray[np.float64]  # (identifiers, most signals), p.u., the largest that was measured
    path: NDArray[np.float64]  # (identifiers, frames, most signals), p.u., past and predicted
    change: NDArray[np.float64]  # (identifiers, most signals), p.u., predicted; NaN: none
    jacobian: NDArray[np.float64]  # (identifiers, most signals, most devices), p.u./p.u.


def past_values(span: Any) -> int:
    """How many past values of each signal an identifier is given whose span is so many frames; none: 0."""
    return 2 if span else 1


def network_of(kind: str, signals: int, devices: int, order: int = 1) -> Network:
    """The network of an identifier: its inputs are past values of the signals and setpoints, its outputs the signals.

    With several of them its consequents are affine (6.9).
    """
    antecedent, consequent = IDENTIFIERS[kind]
    own = MIMO_FORM.get(consequent, consequent) if signals * devices * order > 1 else consequent
    return network(antecedent, own, signals * order + devices, 2, signals)


def identifiers(
    rows: Sequence[Identified], signals: Mapping[str, Signal], stations: Sequence[str], frame_rate: int
) -> tuple[Identifiers, IdentifierState]:
    """The identifiers of a run as tables."""
    n, most = len(rows), max([len(row.devices) for row in rows], default=0)
    outputs = max([len(row.signals) for row in rows], default=0)
    span = np.array([int(row.settings["identifier_span"][0]) for row in rows], np.int64)
    order = np.array([past_values(one) for one in span], np.int64)
    nets = [network_of(row.kind, len(row.signals), len(row.devices), o) for row, o in zip(rows, order, strict=True)]
    starts = [_start(net, row) if row.weights is None else row.weights for net, row in zip(nets, rows, strict=True)]
    given, held = inputs([row.signals for row in rows], signals, stations)
    lag_ns = np.array([to_ns(float(row.settings["lag"][0])) for row in rows], np.int64)
    horizon = np.array([int(row.settings["identifier_horizon"][0]) for row in rows], np.int64)
    ahead_ns = np.where([row.predicts for row in rows], lag_ns, UNSET)
    back = int((horizon + span).max(initial=1))
    lag = int(lag_ns.max(initial=0)) * frame_rate // NANOSECONDS
    kept = lag + back + SPARE
    made = Identifiers(
        controller=np.array([row.controller for row in rows], np.int64),
        settings=np.zeros((n, max(outputs, most)), SETTINGS),
        shape=np.array(nets, np.int64).reshape(n, len(Network._fields)),
        inputs=given,
        device=np.full((n, most), UNSET, np.int64),
        limit=np.ones((n, most)),
        lag_ns=lag_ns,
        horizon=horizon,
        order=order,
        span=span,
        ahead_ns=ahead_ns,
        period_ns=np.full(n, NANOSECONDS // frame_rate, np.int64),
    )
    state = IdentifierState(
        held=held,
        learner=learners(nets, starts),
        past=np.zeros((n, back + 1, outputs)),
        past_ns=np.full((n, back + 1), UNSET, np.int64),
        newest=np.zeros(n, np.int64),
        given_ns=np.full((n, most, kept), UNSET, np.int64),
        given=np.zeros((n, most, kept)),
        at=np.zeros((n, most), np.int64),
        deviation=np.zeros((n, outputs)),
        curvature=np.ones((n, outputs)),
        lyapunov=np.zeros((n, 2)),
        prediction=np.full((n, outputs), np.nan),
        error=np.full((n, outputs), np.nan),
        peak=np.zeros((n, outputs)),
        path=np.zeros((n, back + lag + SPARE, outputs)),
        change=np.full((n, outputs), np.nan),
        jacobian=np.full((n, outputs, most), np.nan),
    )
    for i, row in enumerate(rows):
        size = min(made.settings.shape[1], len(row.settings))
        made.settings[i, :size] = row.settings[:size]
        made.device[i, : len(row.devices)] = row.devices
        made.limit[i, : len(row.devices)] = row.limits
        _first(made, state, i)
    return made, state


def _start(net: Network, row: Identified) -> NDArray[np.float64]:
    """Parameters from which y_I is near y(k-h) + J u for small y and u, J the linear plant's.

    Affine consequents hold J as it is, and in the place of y(k-h) what past values become in the least damped mode.
    Gaussian rules at -h and h give weight tanh(2 sum_i h_i x_i / s^2); two mirrored wavelets give slopes of
    weight (cos 5q)' about q = 0.
    """
    scale = row.settings["scale"][: len(row.signals)]
    by_u = row.known.jacobian * np.array(row.limits) / scale[:, None]
    order = (net.inputs - len(row.devices)) // net.outputs
    if net.outputs * len(row.devices) * order > 1:
        horizon, span = (int(row.settings[f"identifier_{name}"][0]) for name in ("horizon", "span"))
        past = np.concatenate([row.known.swing / scale / row.known.turn ** (span * j) for j in range(order)])
        later = row.known.swing / scale * row.known.turn**horizon
        return _linear_start(net, np.hstack([_ahead(past, later), by_u]))
    weight, by_u = float(row.settings["identifier_weight"][0]), by_u[0]
    slopes = np.concatenate([np.ones(len(row.signals)), by_u])
    width, dilation = np.full(net.inputs, WIDTH), np.full(net.inputs, DILATION)
    spread, shift = np.zeros(net.inputs), np.zeros(net.inputs)
    if IDENTIFIERS[row.kind][1] == "morlet":
        shift[:] = np.pi * DILATION / 10.0  # where cos 5q falls through zero
        weight = DILATION / 5.0 * math.exp(0.5 * (np.pi / 10.0) ** 2)
        shift[len(row.signals) :] = by_u * DILATION**2 / (26.0 * weight)
    else:
        spread[:] = slopes * WIDTH**2 / (2.0 * weight)
    return initial(net, Start([weight], spread, width, shift, dilation))


def _ahead(past: NDArray[np.complex128], later: NDArray[np.complex128]) -> NDArray[np.float64]:
    """The smallest real matrix M, (signals, past values), with M `past` nearest `later`: phasors of a mode.

    Both are turned until real and imaginary part of `past` are at right angles to each other. Then M is the sum of
    later_i past_i^T / |past_i|^2 over the parts i that are more than round-off.
    """
    turn = cmath.exp(-0.5j * cmath.phase(complex((past * past).sum())))
    past, later = past * turn, later * turn
    made = np.zeros((len(later), len(past)))
    for own, to in ((past.real, later.real), (past.imag, later.imag)):
        size = (own * own).sum()
        if size > FLAT**2 * (np.abs(past) ** 2).sum():
            made += to[:, None] * own / size
    return made


def _linear_start(net: Network, slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Two rules of equal affine consequents: y_I = slopes x, (outputs, inputs), whatever fires."""
    many = np.ones(net.inputs)
    members = initial(net, Start(np.zeros(net.outputs), SPREAD * many, WIDTH * many, 0.0 * many, many))
    rule = np.column_stack([np.zeros(net.outputs), slopes]).ravel()
    first = net.size - net.rules * rule.size
    low, high = np.array([(slot.low, slot.high) for slot in slots(net)[first:]]).T
    return np.concatenate([members[:first], np.clip(np.tile(rule, net.rules), low, high)])


@inner
def _look(net: Network, own: Learner, ids: Identifiers, state: IdentifierState, n: int) -> None:
    """Prediction and Jacobian at `own.x`."""
    first = ids.order[n] * net.outputs
    infer(net, own)
    by_inputs(net, own.theta, own.passed)
    for i in range(net.outputs):
        for d in range(net.inputs - first):
            by_u = own.passed.by_input[i, first + d]
            state.jacobian[n, i, d] = by_u * ids.settings[n, i].scale / ids.limit[n, d]


@compiled
def _first(ids: Identifiers, state: IdentifierState, n: int) -> None:
    """The Jacobian that an identifier starts from, at rest."""
    net = shape_of(ids.shape[n])
    _look(net, one(state.learner, n, net), ids, state, n)


@compiled
def remember(ids: Identifiers, state: IdentifierState, n: int, issued: NDArray[Any], count: int) -> None:
    """Keep the setpoints of identifier n's devices among `count` issued ones."""
    for i in range(count):
        for d in range(ids.device.shape[1]):
            if issued[i].device == ids.device[n, d]:
                at = (state.at[n, d] + 1) % state.given.shape[2]
                state.at[n, d] = at
                state.given_ns[n, d, at] = issued[i].measured_ns
                state.given[n, d, at] = issued[i].value


@inner
def _learn(ids: Identifiers, state: IdentifierState, n: int) -> None:
    """Predict the newest frame from past ones and from the setpoints since, and learn from the error.

    Not where one of them is not kept.
    """
    net, s, now = shape_of(ids.shape[n]), ids.settings[n], state.held.newest_ns[n]
    own, p = one(state.learner, n, net), shape_of(ids.shape[n]).outputs
    elapsed = 0
    for k in range(ids.order[n]):
        before = frame_before(ids, state, n, now, ids.horizon[n] + k * ids.span[n])
        if before == UNSET:
            return
        elapsed = elapsed if k else now - state.past_ns[n, before]
        for j in range(p):
            own.x[k * p + j] = state.past[n, before, j] / s[j].scale
    fill(own.x[ids.order[n] * p : net.inputs], ids, state, n, now, elapsed)
    _look(net, own, ids, state, n)
    for j in range(net.outputs):
        state.prediction[n, j] = own.passed.output[j] * s[j].scale
        state.error[n, j] = state.prediction[n, j] - state.held.signal[n, j]
        state.deviation[n, j] = -state.error[n, j] / s[j].scale
    g = s[0]
    rule = Rule(g.identifier_rate, g.identifier_eta, g.identifier_momentum, g.identifier_leakage, g.clip, g.projection)
    learn(net, own, rule, state.deviation[n], state.curvature[n])
    now_is = then = 0.0
    for j in range(net.outputs):
        now_is += 0.5 * state.deviation[n, j] ** 2
        then += 0.5 * (state.deviation[n, j] - own.moved[j]) ** 2
    state.lyapunov[n, 0], state.lyapunov[n, 1] = now_is, now_is - then


@compiled
def identify(ids: Identifiers, state: IdentifierState, n: int, delivered: NDArray[Any], count: int) -> None:
    """One tick of identifier n: `count` delivered entries in; it learns once per new frame that follows the last."""
    s = ids.settings[n, 0]
    i = 0
    while i < count:
        arrival = delivered[i].arrival_ns
        i = take(state.held, n, delivered, i, count)
        if form(ids.inputs, state.held, n) < 0:
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
            look_ahead(ids, state, n, shape_of(ids.shape[n]), one(state.learner, n, shape_of(ids.shape[n])))


@compiled
def tell(ids: Identifiers, state: IdentifierState, n: int, tick: int, out: NDArray[Any], first: int) -> int:
    """The estimates of identifier n after a tick (ESTIMATE) into `out` from `first` on; the index after the last."""
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
