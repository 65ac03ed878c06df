"""Identifiers: networks that predict a controller's signals a frame ahead, and so the plant's Jacobian; compiled.

    y_I(k) = f_I(y(k-1), u(k-1-d)),  f_I += -eta_I (y_I - y) dy_I/df_I + momentum,  J = dy_I/du

(5.1), which pairs y with u of the same frame, (5.12) and (5.6). d is the known delay from measurement to actuation:
setpoints are paired by the measurement that they rest on. All is normalised by the controller's `scale` and the
devices' limits.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.control.inputs import UNSET, Held, Inputs, form, inputs, take
from facts_damping.control.table import SETTINGS
from facts_damping.neurofuzzy.learning import Learner, Rule, infer, learn, learners, one
from facts_damping.neurofuzzy.network import Network, network
from facts_damping.neurofuzzy.start import Start, initial
from facts_damping.neurofuzzy.table import IDENTIFIERS
from facts_damping.signals import NANOSECONDS, to_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.system import Signal

WIDTH = 1.0  # s of the memberships at the start
DILATION = 5.0  # nu of the wavelets at the start
SPARE = 4  # frames, beyond the lag, for which setpoints are kept


class Identified(NamedTuple):
    """What an identifier belongs to: the controller's place, its settings, signals, devices and their limits."""

    controller: int
    settings: NDArray[Any]  # SETTINGS, one record
    kind: str  # a row of IDENTIFIERS
    signals: Sequence[str]
    devices: Sequence[int]
    limits: Sequence[float]  # p.u.
    jacobian: NDArray[np.float64]  # (signals, devices), p.u./p.u.: that of the start
    weights: NDArray[np.float64] | None  # parameters to start from; none: symmetric rules


class Identifiers(NamedTuple):
    """Frozen parameters of all identifiers of a run; the first axis is the identifier."""

    controller: NDArray[np.int64]
    settings: NDArray[Any]  # SETTINGS
    shape: NDArray[np.int64]  # (identifiers, fields of Network)
    inputs: Inputs
    device: NDArray[np.int64]  # (identifiers, most devices); UNSET beyond its own
    limit: NDArray[np.float64]  # (identifiers, most devices), p.u.
    lag_ns: NDArray[np.int64]
    period_ns: NDArray[np.int64]


class IdentifierState(NamedTuple):
    """State of all identifiers; the first axis is the identifier."""

    held: Held
    learner: Learner
    before: NDArray[np.float64]  # (identifiers, most signals), those of the frame before, p.u.
    given_ns: NDArray[np.int64]  # (identifiers, most devices, kept): what the newest setpoints rest on, a ring
    given: NDArray[np.float64]  # the same shape: their values, p.u.
    at: NDArray[np.int64]  # (identifiers, most devices): place of the newest
    deviation: NDArray[np.float64]  # (identifiers, most signals): measurement less prediction, normalised
    curvature: NDArray[np.float64]  # (identifiers, most signals): ones
    prediction: NDArray[np.float64]  # (identifiers, most signals), p.u.; NaN: none yet
    error: NDArray[np.float64]  # (identifiers, most signals), prediction less measurement, p.u.; NaN: none yet
    jacobian: NDArray[np.float64]  # (identifiers, most signals, most devices), p.u./p.u.


def network_of(kind: str, signals: int, devices: int) -> Network:
    """The network of an identifier: its inputs are signals and setpoints, its outputs the signals."""
    return network(*IDENTIFIERS[kind], signals + devices, 2, signals)


def identifiers(
    rows: Sequence[Identified], signals: Mapping[str, Signal], stations: Sequence[str], frame_rate: int
) -> tuple[Identifiers, IdentifierState]:
    """The identifiers of a run as tables."""
    n, most = len(rows), max([len(row.devices) for row in rows], default=0)
    outputs = max([len(row.signals) for row in rows], default=0)
    nets = [network_of(row.kind, len(row.signals), len(row.devices)) for row in rows]
    starts = [_start(net, row) if row.weights is None else row.weights for net, row in zip(nets, rows, strict=True)]
    given, held = inputs([row.signals for row in rows], signals, stations)
    lag_ns = np.array([to_ns(float(row.settings["lag"])) for row in rows], np.int64)
    kept = int(lag_ns.max(initial=0)) * frame_rate // NANOSECONDS + SPARE
    made = Identifiers(
        controller=np.array([row.controller for row in rows], np.int64),
        settings=np.array([row.settings for row in rows], SETTINGS),
        shape=np.array(nets, np.int64).reshape(n, len(Network._fields)),
        inputs=given,
        device=np.full((n, most), UNSET, np.int64),
        limit=np.ones((n, most)),
        lag_ns=lag_ns,
        period_ns=np.full(n, NANOSECONDS // frame_rate, np.int64),
    )
    state = IdentifierState(
        held=held,
        learner=learners(nets, starts),
        before=np.zeros((n, outputs)),
        given_ns=np.full((n, most, kept), UNSET, np.int64),
        given=np.zeros((n, most, kept)),
        at=np.zeros((n, most), np.int64),
        deviation=np.zeros((n, outputs)),
        curvature=np.ones((n, outputs)),
        prediction=np.full((n, outputs), np.nan),
        error=np.full((n, outputs), np.nan),
        jacobian=np.full((n, outputs, most), np.nan),
    )
    for i, row in enumerate(rows):
        made.device[i, : len(row.devices)] = row.devices
        made.limit[i, : len(row.devices)] = row.limits
        _first(made, state, i)
    return made, state


def _start(net: Network, row: Identified) -> NDArray[np.float64]:
    """Parameters from which y_I is near y(k-1) + J u for small y and u, J the linear plant's.

    Gaussian rules at -h and h give weight tanh(2 sum_i h_i x_i / s^2); two mirrored wavelets give slopes of
    weight (cos 5q)' about q = 0.
    """
    weight, scale = float(row.settings["identifier_weight"]), float(row.settings["scale"])
    by_u = row.jacobian[0] * np.array(row.limits) / scale
    slopes = np.concatenate([np.ones(len(row.signals)), by_u])
    width, dilation = np.full(net.inputs, WIDTH), np.full(net.inputs, DILATION)
    spread, shift = np.zeros(net.inputs), np.zeros(net.inputs)
    if IDENTIFIERS[row.kind][1] == "morlet":
        shift[:] = np.pi * DILATION / 10.0  # where cos 5q falls through zero
        weight = DILATION / 5.0 * math.exp(0.5 * (np.pi / 10.0) ** 2)
        shift[len(row.signals) :] = by_u * DILATION**2 / (26.0 * weight)
    else:
        spread[:] = slopes * WIDTH**2 / (2.0 * weight)
    return initial(net, Start(weight, spread, width, shift, dilation))


@compiled
def _net(ids: Identifiers, n: int) -> Network:
    s = ids.shape[n]
    return Network(s[0], s[1], s[2], s[3], s[4], s[5], s[6])


@compiled
def _look(net: Network, own: Learner, ids: Identifiers, state: IdentifierState, n: int) -> None:
    """Prediction and Jacobian at `own.x`."""
    infer(net, own)
    for i in range(net.outputs):
        for d in range(net.inputs - net.outputs):
            by_u = own.passed.by_input[i, net.outputs + d]
            state.jacobian[n, i, d] = by_u * ids.settings[n].scale / ids.limit[n, d]


@compiled
def _first(ids: Identifiers, state: IdentifierState, n: int) -> None:
    """The Jacobian that an identifier starts from, at rest."""
    net = _net(ids, n)
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


@compiled
def _given(state: IdentifierState, n: int, d: int, until_ns: int) -> float:
    """The newest setpoint of device d that rests on a measurement not after `until_ns`; 0 before the first."""
    size = state.given.shape[2]
    for back in range(size):
        at = (state.at[n, d] - back) % size
        if state.given_ns[n, d, at] != UNSET and state.given_ns[n, d, at] <= until_ns:
            return state.given[n, d, at]  # type: ignore[no-any-return]
    return 0.0


@compiled
def identify(ids: Identifiers, state: IdentifierState, n: int, delivered: NDArray[Any], count: int) -> None:
    """One tick of identifier n: `count` delivered entries in; it learns once per new frame that follows the last."""
    net = _net(ids, n)
    own = one(state.learner, n, net)
    s = ids.settings[n]
    i = 0
    while i < count:
        arrival = delivered[i].arrival_ns
        i = take(state.held, n, delivered, i, count)
        since = form(ids.inputs, state.held, n)
        if since < 0:
            continue
        now = state.held.newest_ns[n]
        fresh = s.stale <= 0.0 or (arrival - now) * 1e-9 <= s.stale
        if fresh and 0 < since < 1.5 * ids.period_ns[n]:
            for j in range(net.outputs):
                own.x[j] = state.before[n, j] / s.scale
            for d in range(net.inputs - net.outputs):
                # In force for most of the time from the frame before to this one.
                u = _given(state, n, d, now - since + since // 2 - ids.lag_ns[n])
                own.x[net.outputs + d] = u / ids.limit[n, d]
            _look(net, own, ids, state, n)
            for j in range(net.outputs):
                state.prediction[n, j] = own.passed.output[j] * s.scale
                state.error[n, j] = state.prediction[n, j] - state.held.signal[n, j]
                state.deviation[n, j] = -state.error[n, j] / s.scale
            rule = Rule(
                s.identifier_rate, s.identifier_eta, s.identifier_momentum, s.identifier_leakage, s.clip, s.projection
            )
            learn(net, own, rule, state.deviation[n], state.curvature[n])
        for j in range(net.outputs):
            state.before[n, j] = state.held.signal[n, j]


@compiled
def tell(ids: Identifiers, state: IdentifierState, n: int, tick: int, out: NDArray[Any], first: int) -> int:
    """The estimates of identifier n after a tick (ESTIMATE) into `out` from `first` on; the index after the last."""
    net = _net(ids, n)
    for i in range(net.outputs):
        for d in range(net.inputs - net.outputs):
            row = out[first]
            row.tick = tick
            row.controller = ids.controller[n]
            row.signal = i
            row.device = ids.device[n, d]
            row.measured_ns = state.held.newest_ns[n]
            row.jacobian = state.jacobian[n, i, d]
            row.prediction = state.prediction[n, i]
            row.error = state.error[n, i]
            first += 1
    return first
