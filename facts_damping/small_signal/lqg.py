"""The linear-quadratic-Gaussian controller of a run: optimal for the linearised plant with frames, hold and delay.

It minimises the average over frames of

    sum_k (sum_i dw_i(k)^2 + control_weight sum_p (u_p(k) / u_max,p)^2)                                 p.u.^2

with dw the monitored speed differences, in deviations from the plant's final equilibrium. Disturbances are steps of the
torques on the rotors, of random size at each frame and equal variance in p.u. of the rating. Like changes of loads and
lines, a step shifts the equilibrium, so it counts as a jump away from the new one (`rest` below), and no constant
setpoint opposes it. The measurement noise of a signal is `measurement_noise` times its swing in the least damped mode
when the vector of speed differences has a swing of one.

1. Motions without effect on signals and speed differences (all rotor angles or all speeds shifted) are removed.
2. Modes that do not decay are kept; the decaying part is balanced and truncated (B. C. Moore, Principal Component
   Analysis in Linear Systems, IEEE Trans. Automatic Control 26(1), 1981; the division by the sign of a matrix:
   P. Benner, E. S. Quintana-Orti, G. Quintana-Orti, State-Space Truncation Methods for Parallel Model Reduction of
   Large-Scale Systems, Parallel Computing 29(11-12), 2003).
3. For PMUs with a filter, the states of its samples are added (`sampled_output`).
4. The model is sampled with hold, washouts by the bilinear transform as in controllers, and the Riccati equations are
   solved for regulator and Kalman filter (G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems,
   3rd ed. 1998, 9). With loop_delay = (f + part) T the regulator acts on the predicted state f frames ahead, which
   depends only on setpoints already sent: this is optimal for the plant with its delay.
"""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.measures import measure_weights
from facts_damping.caching import shared
from facts_damping.control.state_space import StateSpace
from facts_damping.devices.table import KINDS
from facts_damping.errors import InputError
from facts_damping.numerics.matrices import lyapunov, product, riccati, root, sign, singular, solve
from facts_damping.numerics.phasors import magnitudes
from facts_damping.signals import NANOSECONDS, to_ns
from facts_damping.small_signal.sampled_output import remember, samples
from facts_damping.small_signal.zero_order_hold import held_for, rigid

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.compiling.structs import Float1, Float2
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller
    from facts_damping.small_signal.residues import Residues
    from facts_damping.small_signal.sampled_output import Filtered

DECAYS = 1e-2  # 1/s: modes with slower decay, or growth, are not truncated
DRIFTS = 1e-3  # 1/s: slower modes count as constant
KEPT = 1e-3  # of the largest Hankel singular value: states with smaller values are truncated
STILL = 1e-6  # p.u. or rad per p.u.: a signal with less swing relative to the speed differences counts as constant


_reduced: dict[bytes, DesignModel] = {}  # by a digest of what they were made from


class DesignModel(NamedTuple):
    """dx = A x + B u + G w, y = C x + D u, z = Z x: setpoints u, torques w, signals y, speed differences z; p.u."""

    A: Float2  # (states, states), 1/s
    B: Float2  # (states, devices)
    G: Float2  # (states, machines)
    C: Float2  # (signals, states)
    D: Float2  # (signals, devices)
    Z: Float2  # (differences, states)

    def within(self, T: Float2, back: Float2) -> DesignModel:
        """The model in states z with x = T z, `back` T = 1."""
        of_inputs = product(back, self.B), product(back, self.G)
        return DesignModel(product(back, self.A, T), *of_inputs, product(self.C, T), self.D, product(self.Z, T))


def design(plant: Residues | None, system: System, controller: Controller, here: str) -> StateSpace:
    """The controller's matrices. Raises `InputError` if plant and signals do not permit a design; `here`: its field."""
    if plant is None:
        raise InputError(f"{here}.name: 'LQG' given, but the plant has no electromechanical mode; allowed: LLC")
    whole = model(plant, system, controller)
    rows = [plant.signals.index(name) for name in controller.signals]
    size = magnitudes(plant.mode_shape[rows]) / np.sqrt((magnitudes(product(whole.Z, plant.shape)) ** 2).sum())
    _check(plant, system, controller, size, here)
    whole, names = without_integrals(whole, plant.names, system)
    limits = np.array([system.device(name).setpoint_max for name in controller.devices])
    filters = None if plant.model.filtered is None else plant.model.filtered.of(rows)
    swing = size
    if filters is not None:
        swing = magnitudes(product(filters.C, plant.shape)) * size / magnitudes(plant.mode_shape[rows])
    key = sha256(b"".join(array.tobytes() for array in (*whole, limits, swing)) + repr(names).encode()).digest()
    small = shared(_reduced, key, lambda: reduced(whole, names, limits, swing))
    if np.abs(np.linalg.eigvals(small.A)).min() < DRIFTS:
        raise InputError(
            f"{here}.signals: {', '.join(controller.signals)} given, which contain the rotors' common motion, "
            "which does not decay; allowed: for LQG speed differences, or signals with a washout"
        )
    filters = None if filters is None else filters._replace(C=small.C, D=small.D)
    latency = 0.0 if filters is None else filters.delay  # the filter's samples are part of the model
    step = sampled(small, plant.frame_rate, max(0.0, controller.number("loop_delay") - latency))
    weight, noise = controller.number("control_weight"), np.array(controller.parameters["measurement_noise"]) * size
    try:
        return optimal(small, step, filters, plant.model.washout[rows], 1.0 / plant.frame_rate, limits, weight, noise)
    except np.linalg.LinAlgError as error:
        raise InputError(
            f"{here}: LQG given, but Riccati's equations have no solution: an undamped mode is not observable "
            f"in {', '.join(controller.signals)} or not controllable by {', '.join(controller.devices)}; "
            "allowed: signals and devices for which all such modes are"
        ) from error


def without_integrals(whole: DesignModel, names: list[str], system: System) -> tuple[DesignModel, list[str]]:
    """The model without integrals that act on nothing, as the charges of batteries, and the names of its states."""
    idle = {f"{device.name}.{state}" for device in system.devices for state in KINDS[device.kind].integrals}
    staying = [i for i, name in enumerate(names) if name not in idle]
    if len(staying) == len(names):
        return whole, names
    T = np.eye(len(names))[:, staying]
    return whole.within(T, T.T), [names[i] for i in staying]


def _check(plant: Residues, system: System, controller: Controller, size: Float1, here: str) -> None:
    """Check that signals return to zero at rest, and that they swing."""
    for i, (name, swing) in enumerate(zip(controller.signals, size, strict=True)):
        signal = system.signals[name]
        if signal.channel not in ("speed_deviation", "frequency") and signal.washout == 0.0:
            raise InputError(
                f"{here}.signals.{i}: '{name}' given, which is not zero in the steady state; "
                "allowed: for LQG speed deviations, frequencies, or signals with a washout"
            )
        if not swing > STILL:
            raise InputError(
                f"{here}.signals.{i}: '{name}' given, which does not swing at the least damped mode "
                f"({plant.frequency_hz:.2f} Hz); allowed: signals that do"
            )


def model(plant: Residues, system: System, controller: Controller) -> DesignModel:
    """The linearised plant of a controller; signals before washouts and filters."""
    rows = [plant.signals.index(name) for name in controller.signals]
    columns = [plant.devices.index(name) for name in controller.devices]
    machine = {pmu.name: pmu.machine for pmu in system.pmus}
    differences = measure_weights({"system": system.model_dump(by_alias=True)}).values()
    G, Z = np.zeros((len(plant.names), len(system.machines))), np.zeros((len(differences), len(plant.names)))
    for i, rotor in enumerate(system.machines):
        G[plant.names.index(f"{rotor.name}.omega"), i] = 1.0 / (2.0 * rotor.H)
    for i, weights in enumerate(differences):
        for pmu, weight in weights.items():
            state = f"{machine[pmu]}.omega"
            if state not in plant.names:
                rotors = [s.name for s in system.pmus if f"{s.machine}.omega" in plant.names]
                text = f"measures: {pmu} given, without a rotor; allowed: for LQG {', '.join(rotors) or 'none'}"
                raise InputError(text)
            Z[i, plant.names.index(state)] += weight
    linear = plant.model
    C, D = linear.seen
    return DesignModel(linear.A, linear.B[:, columns], G, C[rows], D[np.ix_(rows, columns)], Z)


def reduced(whole: DesignModel, names: Sequence[str], limits: Float1, size: Float1) -> DesignModel:
    """The model without rigid motions and truncated; signals are scaled by `size`, setpoints by limits.

    P, from the sign of the matrix, splits the states as x = P x + (1 - P) x into the decaying part and the rest. In
    each part the other one, and in both the rigid motions, are uncontrollable and unobservable, with a decay of 1/s.
    """
    eye = np.eye(len(whole.A))
    still = rigid(whole.A, np.vstack([whole.C, whole.Z]), names)
    hidden = product(still, still.T)
    seen = whole.within(eye - hidden, eye - hidden)
    P = (eye - sign(seen.A - hidden + DECAYS * eye)) / 2.0
    staying, sizes, seeing = singular(eye - P)
    stays = round(float(np.trace(eye - P)))
    fast = seen.within(P, P)
    inputs, outputs = np.hstack([fast.B * limits, fast.G]), np.vstack([fast.C / size[:, None], fast.Z])
    T, back = balancing(fast.A - (eye - P) - hidden, inputs, outputs)
    return seen.within(np.hstack([staying[:, :stays], T]), np.vstack([sizes[:stays, None] * seeing[:, :stays].T, back]))


def balancing(A: Float2, B: Float2, C: Float2) -> tuple[Float2, Float2]:
    """T (states, kept) and back: x = T z, z the balanced states with a Hankel singular value of at least KEPT."""
    reach = root(lyapunov(A, product(B, B.T)))
    observe = root(lyapunov(A.T, product(C.T, C)))
    left, values, right = singular(product(observe.T, reach))
    order = int(np.sum(values >= KEPT * values.max(initial=0.0)))
    scale = 1.0 / np.sqrt(values[:order])
    return product(reach, right[:, :order]) * scale, (product(observe, left[:, :order]) * scale).T


class SampledModel(NamedTuple):
    """x(k+1) = Phi x(k) + old u(k-f-1) + new u(k-f) + torque w(k): a model from frame to frame with its delay."""

    Phi: Float2  # (states, states)
    old: Float2  # (states, devices)
    new: Float2  # (states, devices)
    torque: Float2  # (states, machines)
    f: int
    part: float  # s, from a frame until u(k-f) acts


def sampled(small: DesignModel, frame_rate: int, loop_delay: float) -> SampledModel:
    """A model sampled with hold, with setpoints delayed by `loop_delay`, s; exact (Astrom, Wittenmark, 1997, 2.3)."""
    period, devices = 1.0 / frame_rate, small.B.shape[1]
    f, rest = divmod(to_ns(loop_delay) * frame_rate, NANOSECONDS)
    part = rest / NANOSECONDS * period
    onward, new = held_for(small.A, small.B, period - part)
    Phi, both = held_for(small.A, np.hstack([small.B, small.G]), period)
    return SampledModel(Phi, product(onward, held_for(small.A, small.B, part)[1]), new, both[:, devices:], f, part)


def optimal(
    small: DesignModel,
    step: SampledModel,
    filters: Filtered | None,
    washout: Float1,
    period: float,
    limits: Float1,
    control_weight: float,
    measurement_noise: Float1,
) -> StateSpace:
    """Regulator and filter; states are the model's, those of washouts, of PMU filters, then u(k-1) to u(k-f-1).

    `washout`, s, and `measurement_noise`, standard deviation, of each signal; `control_weight`, of a setpoint at its
    limit, p.u.^2.
    """
    through, pole, pick = washouts(washout, period)
    devices, memory = len(limits), 0 if filters is None else filters.frames * len(washout)
    states = len(step.Phi) + len(pole) + memory
    ends = np.cumsum([len(step.Phi), len(pole), memory, *[devices] * (step.f + 1)])
    x, faded, memory_rows, *sent = np.split(np.eye(ends[-1] + devices), ends)  # rows that select each part
    sent = [sent[-1], *sent[:-1]]  # u(k) to u(k-f-1)
    raw, remembered = product(small.C, x) + product(small.D, sent[-1]), memory_rows
    if filters is not None:
        raw = filters.taps[:, 0, None] * raw + memory_rows[: len(washout)]
        inputs = [(list(range(devices)), sent[-1], sent[step.f], step.part)]
        remembered = remember(filters, samples(filters, small.A, small.B, x, inputs), memory_rows)
    y = product(through, raw - product(pick.T, faded))
    moved = product(step.Phi, x) + product(step.old, sent[-1]) + product(step.new, sent[step.f])
    washed = product(pole, faded) + product(np.eye(len(pole)) - pole, pick, raw)
    after = np.vstack([moved, washed, remembered, *sent[:-1]])
    ahead = x  # predicted state, f frames ahead
    for i in range(step.f, 0, -1):
        ahead = product(step.Phi, ahead) + product(step.old, sent[i + 1]) + product(step.new, sent[i])

    torque = np.vstack([step.torque, np.zeros((states - len(step.torque), step.torque.shape[1]))])
    M = np.zeros((ends[-1], len(measurement_noise)))
    rest = solve(np.eye(states) - after[:states, :states], torque)  # equilibrium after a step of each torque
    M[:states] = filter_gain(after[:states, :states], rest, y[:, :states], measurement_noise)
    K = product(regulator_gain(step, small.Z, limits, control_weight), np.vstack([ahead, sent[1]]))
    n = ends[-1]
    return StateSpace(after[:, :n], after[:, n:], y[:, :n], M, K[:, :n])


def washouts(washout: Float1, period: float) -> tuple[Float2, Float2, Float2]:
    """Washouts by the bilinear transform: p s(k) + (1 - p) y(k) = s(k+1), with output g (y - s).

    Returns g of all signals (1 without washout), p of those with one, and the rows that select these.
    """
    twice = 2.0 * washout / period
    has = washout > 0.0
    return (
        np.diag(np.where(has, twice / (1.0 + twice), 1.0)),
        np.diag(((twice - 1.0) / (twice + 1.0))[has]),
        np.eye(len(washout))[has],
    )


def filter_gain(A: Float2, G: Float2, C: Float2, measurement_noise: Float1) -> Float2:
    """M of the Kalman filter, P C^T (C P C^T + R)^-1, with signals in units of their noise."""
    seen, eye = C / measurement_noise[:, None], np.eye(len(measurement_noise))
    P = riccati(A.T, seen.T, product(G, G.T), eye)
    return np.asarray(solve(product(seen, P, seen.T) + eye, product(seen, P)).T / measurement_noise)


def regulator_gain(step: SampledModel, Z: Float2, limits: Float1, control_weight: float) -> Float2:
    """K of u(k) = -K [x(k+f), u(k-1)], with setpoints in units of their limits."""
    n, devices = step.new.shape
    A = np.block([[step.Phi, step.old * limits], [np.zeros((devices, n + devices))]])
    B = np.vstack([step.new * limits, np.eye(devices)])
    eye, Z = np.eye(devices), np.hstack([Z, np.zeros((len(Z), devices))])
    X = riccati(A, B, product(Z.T, Z) / control_weight, eye)
    K = solve(eye + product(B.T, X, B), product(B.T, X, A))
    return np.asarray(limits[:, None] * K / np.concatenate([np.ones(n), limits]))
