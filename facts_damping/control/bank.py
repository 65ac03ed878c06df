"""All controllers of a run as arrays, and a controller's tick; compiled.

A controller acts once per arrival, at the arrival's exact time: it updates the newest entry of each PMU, forms its
signals, and issues a setpoint for each of its devices. Between arrivals the setpoint is constant (zero-order hold).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import branching, compiled, entry_point
from facts_damping.compiling.structs import Array, Float1, Float2, Float3, Int1, Int2, Struct
from facts_damping.control import neuro_fuzzy, state_space, table
from facts_damping.control.called import Calls, call, calls
from facts_damping.control.compensation import Compensated, Compensators, compensate, compensators
from facts_damping.control.faults import Faults, corrupt, faults, misbehave, silent
from facts_damping.control.inputs import UNSET, Inputs, LatestSamples, Wiring, compute_signals, ingest, inputs
from facts_damping.control.neuro_fuzzy import Adaptive, AllActuators, Memories, memories
from facts_damping.control.state_space import Commands, Observers, StateSpace, state_spaces
from facts_damping.control.table import kind_of
from facts_damping.elementary import cos
from facts_damping.neurofuzzy.learning import Learners, learners
from facts_damping.neurofuzzy.network import Network, network, shape_of
from facts_damping.neurofuzzy.start import Start, initial
from facts_damping.numerics.phasors import angles, magnitudes, over, times
from facts_damping.parameters.run import Weights
from facts_damping.signals import NANOSECONDS, Deliveries, Setpoints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.control.neuro_fuzzy import PlantPrior
    from facts_damping.control.parameter_tables import Parameter, Value
    from facts_damping.parameters.run import Controller

law_of = branching(table.LAWS)  # arguments: a code, then those of a law
RULES = 2  # of every network (thesis, chapter 3)


class Bank(Struct):
    """Constant parameters of all controllers of a run; the first axis is the controller."""

    code: Int1
    law: Int1  # (controllers,): index in LAWS, if the kind has a law
    settings: Annotated[
        NDArray[Any], Array(table.SETTINGS, 2)
    ]  # (controllers, most signals or devices) of SETTINGS: a row per signal or device
    mode_shape: Float2  # (controllers, most signals), relative to the first signal at the mode; 1: unknown
    inputs: Inputs
    compensators: Compensators
    shape: Int2  # (controllers, fields of Network)
    sensitivity: Float3  # (controllers, most signals, most devices): sign of dy/du; 0: none
    device: Int2  # (controllers, most devices): installed device; UNSET: unused
    actuators: AllActuators  # (controllers, most devices)
    period_ns: Int1  # (controllers,), between frames
    optimal: Observers  # matrices of observers with state feedback
    faults: Faults


class BankState(Struct):
    """State of all controllers; the first axis is the controller."""

    held: LatestSamples
    compensated: Compensated
    jacobian: Float3  # (controllers, most signals, most devices), p.u./p.u., newest estimate; NaN: none
    unlimited: Float2  # (controllers, most devices), p.u., setpoints before limits
    outputs: Float2  # (controllers, most devices), p.u., setpoints after limits
    internal: Float3  # (controllers, most devices, most states): states of lead-lags
    learner: Learners
    memory: Memories
    estimate: Float3  # (controllers, 2, most states): state of observers, work space
    calls: Calls


class Known(NamedTuple):
    """What a controller knows of the plant."""

    prior: PlantPrior | None = None  # None: without a network
    omega: float = 0.0  # of the mode whose delay is compensated, rad/s
    observer: StateSpace | None = None  # None: without one


def build_bank(
    controllers: Sequence[Controller], wiring: Wiring, known: Sequence[Known], seed: int = 0
) -> tuple[Bank, BankState]:
    """Build the controllers of a run; `known`: of each; `seed`: of the run."""
    n = len(controllers)
    kinds = [kind_of(c) for c in controllers]
    nets = [controller_network(c) for c in controllers]
    max_signals = max([len(c.signals) for c in controllers], default=0)
    max_devices = max([len(c.devices) for c in controllers], default=0)
    receivers, held = inputs([c.signals for c in controllers], wiring.signals, wiring.pmus, wiring.nominal)
    names = [controller.compensation for controller in controllers]
    optimal, estimate = state_spaces([row.observer for row in known], max_signals, max_devices)
    compensation, compensated = compensators(names, [row.omega for row in known], max_signals)
    controls = Bank(
        code=np.array([k.code(c.scheme) for c, k in zip(controllers, kinds, strict=True)], np.int64),
        law=np.array([table.LAWS.index(k.law) if k.law else 0 for k in kinds], np.int64),
        settings=np.zeros((n, max(max_signals, max_devices)), table.SETTINGS),
        mode_shape=np.ones((n, max_signals)),
        inputs=receivers,
        compensators=compensation,
        shape=np.array(nets, np.int64).reshape(n, len(Network._fields)),
        sensitivity=np.zeros((n, max_signals, max_devices)),
        device=np.full((n, max_devices), UNSET, np.int64),
        actuators=AllActuators(*np.ones((2, n, max_devices))),
        period_ns=np.full(n, NANOSECONDS // wiring.frame_rate, np.int64),
        optimal=optimal,
        faults=faults([c.faults for c in controllers], wiring.frame_rate, seed),
    )
    for c, controller in enumerate(controllers):
        _fill(controls, c, controller, wiring, known[c].prior)
    starts = [_start(nets[c], controls.settings[c], controllers[c], known[c].prior) for c in range(n)]
    state = BankState(
        held=held,
        compensated=compensated,
        jacobian=np.full((n, max_signals, max_devices), np.nan),
        unlimited=np.zeros((n, max_devices)),
        outputs=np.zeros((n, max_devices)),
        internal=np.zeros((n, max_devices, max([k.states for k in kinds], default=0))),
        learner=learners(nets, starts),
        memory=memories(n, max_signals, max_devices),
        estimate=estimate,
        calls=calls(n, max_signals, len(wiring.pmus)),
    )
    return controls, state


def _fill(controls: Bank, c: int, controller: Controller, wiring: Wiring, prior: PlantPrior | None) -> None:
    """Write the devices and settings of controller c."""
    order = list(wiring.limits)
    for d, device in enumerate(controller.devices):
        controls.device[c, d] = order.index(device)
        controls.actuators.limit[c, d], controls.actuators.rate[c, d] = wiring.limits[device]
    if prior is not None:
        controls.mode_shape[c, : len(controller.signals)] = magnitudes(prior.mode_shape)
        controls.sensitivity[c, : len(controller.signals), : len(controller.devices)] = prior.sign
    settings(controller, controls.settings[c], controls.mode_shape[c])


def settings(controller: Controller, rows: NDArray[Any], swing: Float1) -> NDArray[Any]:
    """Write a controller's parameters to SETTINGS records, one per signal or device; returns the records."""
    for name, parameter in kind_of(controller).parameters.items():
        put(rows, name, parameter, controller.parameters.get(name, parameter.default), swing)
    return rows


def put(rows: NDArray[Any], name: str, parameter: Parameter, value: Value, swing: Float1) -> None:
    """Write a parameter's value to SETTINGS records.

    A single value holds for every device. For a parameter of signals it holds for the first signal, and `swing`, the
    signals' swing relative to the first, scales it for the others.
    """
    number = parameter.number(value)
    if parameter.each == "signal" and not isinstance(value, list):
        number = np.asarray(number) * swing
    if np.ndim(number) == 0:
        rows[name] = number
    else:
        rows[name][: np.size(number)] = number


def controller_network(controller: Controller) -> Network:
    """A controller's network; without rules if it has none."""
    shape = table.variant_of(kind_of(controller), len(controller.devices))
    if shape is None:
        return network("gaussian", "singleton", 0, 0, 0)
    return network(shape.antecedent, shape.consequent, 2 * len(controller.signals), RULES, len(controller.devices))


def _start(net: Network, s: NDArray[Any], controller: Controller, known: PlantPrior | None) -> Float1:
    """Initial parameters of a network: those given, or symmetric rules whose sign damps the plant."""
    if known is None:
        return np.zeros(0)
    if isinstance(controller.weights, Weights) and controller.weights.controller is not None:
        return np.array(controller.weights.controller)
    weight, spread = (
        known.sign[0] * s["weight"][: net.outputs],
        pull(known, s[: len(known.mode_shape)]) * s["spread"][0],
    )
    many = np.ones(net.inputs)
    return initial(net, Start(weight, spread, many * s["width"][0], 0.0 * many, many * s["dilation"][0]))


def pull(known: PlantPrior, s: NDArray[Any]) -> Float1:
    """Initial weight of each input of a network, (inputs,).

    1 for the first signal's two inputs; for the others the cosine of the angle, at the least damped mode, between the
    input's phasor and the sum of those two.
    """
    change = 1.0 - over(1.0, known.z_pole)
    swing = over(known.mode_shape, s["scale"])
    steps = over(times(known.mode_shape, change), s["change_scale"])
    phasors = np.column_stack([swing, steps]).ravel()
    weights = [cos(angle) for angle in angles(over(phasors, phasors[0] + phasors[1])).tolist()]
    return np.array([1.0, 1.0, *weights[2:]])


@entry_point
def _neuro_fuzzy(bank: Bank, state: BankState, c: int, since_ns: int, age_ns: int) -> None:
    net, s = shape_of(bank.shape[c]), bank.settings[c]
    adaptive = Adaptive(net, state.learner.each[c], state.memory.each[c], s, bank.actuators.each[c])
    for i in range(net.inputs // 2):
        for d in range(net.outputs):
            sign = bank.sensitivity[c, i, d]
            estimate = state.jacobian[c, i, d] * bank.actuators.limit[c, d] / s[i].scale
            if s[0].sign_guard > 0.0 and estimate * sign < 0.0:
                estimate = 0.0
            adaptive.memory.jacobian[i, d] = sign if bank.code[c] == table.DIRECT else estimate
    frames = 0 if since_ns == 0 else max(1, round(since_ns / bank.period_ns[c]))
    stale = s[0].stale > 0.0 and age_ns * 1e-9 > s[0].stale
    neuro_fuzzy.step(adaptive, state.compensated.signal[c], state.unlimited[c], since_ns * 1e-9, frames, stale)


@compiled
def _optimal(bank: Bank, state: BankState, c: int, since_ns: int) -> None:
    frames = 0 if since_ns == 0 else max(1, round(since_ns / bank.period_ns[c]))
    signals = state.compensated.signal[c, : bank.inputs.signals[c]]
    commands = Commands(state.outputs[c], state.memory.applied[c], state.unlimited[c])
    state_space.step(
        bank.optimal.each[c], state.estimate[c], signals, bank.actuators.each[c], commands, since_ns * 1e-9, frames
    )


@compiled
def _issue(bank: Bank, state: BankState, c: int, tick: int, arrival: int, out: NDArray[Any], first: int) -> int:
    """Write the setpoints of controller c to `out` from index `first` on; returns the index after the last.

    They are limited, with zero for a non-finite one; then the controller's faults apply.
    """
    for d in range(bank.device.shape[1]):
        limit, value = bank.actuators.limit[c, d], state.unlimited[c, d]
        value = min(max(value, -limit), limit) if math.isfinite(value) else 0.0
        state.outputs[c, d] = misbehave(bank.faults, c, tick, d, value, state.outputs[c, d], limit)
        if bank.device[c, d] != UNSET:
            row = out[first]
            row.tick = tick
            row.controller = c
            row.device = bank.device[c, d]
            row.measured_ns = state.held.newest_ns[c]
            row.issued_ns = arrival
            row.effective_ns = arrival
            row.value = state.outputs[c, d]
            first += 1
    return first


@entry_point
def set_estimate(state: BankState, c: int, jacobian: Float2, change: Float1, measured_ns: int) -> None:
    """Give controller c an identifier's estimate for its next tick; `measured_ns`: newest frame used for it."""
    for i in range(jacobian.shape[0]):
        state.compensated.change[c, i] = change[i]
        for d in range(jacobian.shape[1]):
            state.jacobian[c, i, d] = jacobian[i, d]
    state.compensated.change_ns[c] = measured_ns


@entry_point
def act(
    bank: Bank, state: BankState, c: int, tick: int, delivered: Deliveries, count: int, out: Setpoints, first: int
) -> int:
    """Run a tick of controller c: process `count` delivered entries, write setpoints to `out` from index `first` on.

    Entries of the same arrival are processed together. The controller acts if a frame is newer than all before and all
    signals are available. Controllers with given setpoints (`state.unlimited`), and called ones that request it, act
    only at the last such arrival of a tick. A called controller that has failed issues no more setpoints. Returns the
    index after the last setpoint.
    """
    if silent(bank.faults, c, tick):
        return first
    corrupt(bank.faults, c, tick, state.learner.theta[c])
    i, last = 0, UNSET
    called = bank.code[c] == table.CALLED
    once = bank.code[c] == table.GIVEN or (called and state.calls.once[c])
    while i < count:
        arrival = delivered[i].arrival_ns
        i = ingest(bank.inputs, state.held, c, delivered, i, count)
        since = compute_signals(bank.inputs, state.held, c)
        if since < 0:
            continue
        newest = state.held.newest_ns[c]
        age, signals = (arrival - newest) * 1e-9, state.held.signal[c]
        compensate(bank.compensators, state.compensated, c, bank.settings[c, 0], signals, newest, age, since * 1e-9)
        if once:
            last = arrival
            continue
        if bank.code[c] == table.LAW:
            for d in range(bank.device.shape[1]):
                if bank.device[c, d] != UNSET:
                    state.unlimited[c, d] = law_of(
                        bank.law[c],
                        bank.settings[c, d],
                        state.internal[c, d],
                        state.compensated.signal[c, 0],
                        since * 1e-9,
                    )
        elif bank.code[c] == table.STATE_SPACE:
            _optimal(bank, state, c, since)
        elif called:
            if not call(bank.inputs, state.held, state.calls, c, arrival):
                return first
        else:
            _neuro_fuzzy(bank, state, c, since, arrival - newest)
        first = _issue(bank, state, c, tick, arrival, out, first)
    if last != UNSET:
        if called and not call(bank.inputs, state.held, state.calls, c, last):
            return first
        first = _issue(bank, state, c, tick, last, out, first)
    return first
