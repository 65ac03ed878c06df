"""The controllers of a run side by side, and what each does in a tick; compiled.

A controller acts once per arrival, with the arrival's exact time: it updates what it holds of each
station, forms its signals, and issues a setpoint for each device it commands. Between arrivals the
setpoint stands (zero-order hold).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.control import lead_lag, neuro_fuzzy
from facts_damping.control.inputs import UNSET, Held, Inputs, form, inputs, take
from facts_damping.control.neuro_fuzzy import Actuators, Memory, memories
from facts_damping.control.table import DIRECT, INDIRECT, LEAD_LAG, SETTINGS, kind
from facts_damping.neurofuzzy.learning import Learner, learners, one
from facts_damping.neurofuzzy.network import Network, network
from facts_damping.neurofuzzy.start import Start, initial
from facts_damping.parameters.run import Weights
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Controller
    from facts_damping.parameters.system import Signal

SCHEMES = {None: LEAD_LAG, "direct": DIRECT, "indirect": INDIRECT}
RULES = 2  # of every network (thesis, chapter 3)


class Bank(NamedTuple):
    """Frozen parameters of all controllers of a run; the first axis is the controller."""

    code: NDArray[np.int64]
    settings: NDArray[Any]  # (controllers,) of SETTINGS
    inputs: Inputs
    shape: NDArray[np.int64]  # (controllers, fields of Network)
    sensitivity: NDArray[np.float64]  # (controllers, most signals, most devices), signs of dy/du
    device: NDArray[np.int64]  # (controllers, most devices), UNSET beyond its own
    actuators: Actuators  # (controllers, most devices)
    period_ns: NDArray[np.int64]  # (controllers,), of the frames


class BankState(NamedTuple):
    """State of all controllers; the first axis is the controller."""

    held: Held
    jacobian: NDArray[np.float64]  # (controllers, most signals, most devices), p.u./p.u., as last estimated; NaN: never
    unlimited: NDArray[np.float64]  # (controllers, most devices), p.u.
    outputs: NDArray[np.float64]  # (controllers, most devices), p.u.
    internal: NDArray[np.float64]  # (controllers, most states), of lead-lags
    learner: Learner
    memory: Memory


def bank(
    controllers: Sequence[Controller],
    signals: Mapping[str, Signal],
    stations: Sequence[str],
    limits: Mapping[str, tuple[float, float]],
    frame_rate: int,
    signs: Mapping[tuple[str, str], float],
) -> tuple[Bank, BankState]:
    """The controllers of a run as tables.

    `limits`: magnitude (p.u.) and rate (p.u./s) of the installed devices in their order; `signs` of dy/du by
    (signal, device), for neuro-fuzzy controllers.
    """
    n = len(controllers)
    kinds = [kind(c.name) for c in controllers]
    nets = [network_of(c) for c in controllers]
    most_signals = max([len(c.signals) for c in controllers], default=0)
    most_devices = max([len(c.devices) for c in controllers], default=0)
    given, held = inputs([c.signals for c in controllers], signals, stations)
    made = Bank(
        code=np.array([SCHEMES[c.scheme] for c in controllers], np.int64),
        settings=np.array([settings(c) for c in controllers], SETTINGS),
        inputs=given,
        shape=np.array(nets, np.int64).reshape(n, len(Network._fields)),
        sensitivity=np.zeros((n, most_signals, most_devices)),
        device=np.full((n, most_devices), UNSET, np.int64),
        actuators=Actuators(*np.ones((2, n, most_devices))),
        period_ns=np.full(n, NANOSECONDS // frame_rate, np.int64),
    )
    order = list(limits)
    for c, controller in enumerate(controllers):
        for d, device in enumerate(controller.devices):
            made.device[c, d] = order.index(device)
            made.actuators.limit[c, d], made.actuators.rate[c, d] = limits[device]
            for i, signal in enumerate(controller.signals):
                made.sensitivity[c, i, d] = signs.get((signal, device), 0.0)
    starts = [_start(net, made, c, controllers[c]) for c, net in enumerate(nets)]
    state = BankState(
        held=held,
        jacobian=np.full((n, most_signals, most_devices), np.nan),
        unlimited=np.zeros((n, most_devices)),
        outputs=np.zeros((n, most_devices)),
        internal=np.zeros((n, max([k.states for k in kinds], default=0))),
        learner=learners(nets, starts),
        memory=memories(n, most_signals, most_devices),
    )
    return made, state


def settings(controller: Controller) -> Any:
    """A controller's parameters as a record of SETTINGS."""
    row = np.zeros((), SETTINGS)
    for name, parameter in kind(controller.name).parameters.items():
        row[name] = parameter.number(controller.parameters.get(name, parameter.default))
    return row


def network_of(controller: Controller) -> Network:
    """A controller's network; that of a lead-lag has no rules."""
    shape = kind(controller.name).network
    if shape is None:
        return network("gaussian", "singleton", 0, 0, 0)
    return network(shape.antecedent, shape.consequent, 2 * len(controller.signals), RULES, len(controller.devices))


def _start(net: Network, made: Bank, c: int, controller: Controller) -> NDArray[np.float64]:
    """Parameters of a network at the start: those given, or symmetric rules that damp by the plant's sign."""
    if net.rules == 0:
        return np.zeros(0)
    if isinstance(controller.weights, Weights) and controller.weights.controller is not None:
        return np.array(controller.weights.controller)
    s = made.settings[c]
    sign = 1.0 if made.sensitivity[c, 0, 0] >= 0.0 else -1.0
    many = np.ones(net.inputs)
    start = Start(sign * float(s["weight"]), many * s["spread"], many * s["width"], 0.0 * many, many * s["dilation"])
    return initial(net, start)


@compiled
def _limit(made: Bank, state: BankState, c: int) -> None:
    """Setpoints within the devices' limits; one that is not finite counts as zero."""
    for d in range(made.device.shape[1]):
        limit, value = made.actuators.limit[c, d], state.unlimited[c, d]
        state.outputs[c, d] = min(max(value, -limit), limit) if math.isfinite(value) else 0.0


@compiled
def _learnt(made: Bank, state: BankState, c: int, since_ns: int, age_ns: int) -> None:
    """A neuro-fuzzy controller's step."""
    shape, s = made.shape[c], made.settings[c]
    net = Network(shape[0], shape[1], shape[2], shape[3], shape[4], shape[5], shape[6])
    own = one(state.learner, c, net)
    m = state.memory
    kept = Memory(m.before[c], m.applied[c], m.error[c], m.curvature[c], m.jacobian[c], m.taught[c])
    actuators = Actuators(made.actuators.limit[c], made.actuators.rate[c])
    for i in range(made.sensitivity.shape[1]):
        for d in range(made.sensitivity.shape[2]):
            sign = made.sensitivity[c, i, d]
            estimate = state.jacobian[c, i, d] * made.actuators.limit[c, d] / s.scale
            if s.sign_guard > 0.0 and estimate * sign < 0.0:
                estimate = 0.0
            kept.jacobian[i, d] = sign if made.code[c] == DIRECT else estimate
    frames = 0 if since_ns == 0 else max(1, round(since_ns / made.period_ns[c]))
    stale = s.stale > 0.0 and age_ns * 1e-9 > s.stale
    neuro_fuzzy.step(
        net,
        own,
        kept,
        s,
        state.held.signal[c],
        actuators,
        state.unlimited[c],
        since_ns * 1e-9,
        frames,
        stale,
    )


@compiled
def act(
    made: Bank,
    state: BankState,
    c: int,
    tick: int,
    delivered: NDArray[Any],
    count: int,
    out: NDArray[Any],
    first: int,
) -> int:
    """One tick of controller c: `count` delivered entries in, setpoints into `out` from index `first` on.

    Entries of the same arrival are taken together; it acts if a frame is newer than all before and all signals are
    there. Returns the index after the last setpoint written.
    """
    i = 0
    while i < count:
        arrival = delivered[i].arrival_ns
        i = take(state.held, c, delivered, i, count)
        since = form(made.inputs, state.held, c)
        if since < 0:
            continue
        newest = state.held.newest_ns[c]
        if made.code[c] == LEAD_LAG:
            state.unlimited[c, 0] = lead_lag.step(
                made.settings[c], state.internal[c], state.held.signal[c, 0], since * 1e-9
            )
        else:
            _learnt(made, state, c, since, arrival - newest)
        _limit(made, state, c)
        for d in range(made.device.shape[1]):
            if made.device[c, d] != UNSET:
                row = out[first]
                row.tick = tick
                row.controller = c
                row.device = made.device[c, d]
                row.measured_ns = newest
                row.issued_ns = arrival
                row.effective_ns = arrival
                row.value = state.outputs[c, d]
                first += 1
    return first
