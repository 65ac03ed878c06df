"""The linear-quadratic-Gaussian controller of a run: optimal for its linearised plant, frames, hold and delay.

Frame by frame it makes the least, on average, of

    sum_k (sum_i dw_i(k)^2 + effort sum_p (u_p(k) / u_max,p)^2)                                 p.u.^2

dw the speed differences that the system is judged by, deviations from where the plant comes to rest. Disturbances are
steps of the torques on the rotors, of a random size at each frame, the same for all in p.u. of the rating: as loads and
lines leave them, the plant finds another place to rest, so each is a jump away from it (`rest` below) and no setpoint
is held against it. Measurement noise of a signal is `noise` times how far it swings in the least damped mode where the
speed differences, as a vector, swing by one.

1. What no signal and no speed difference answers to (all rotors turned alike, all speeds raised alike) is left out.
2. Modes that do not decay are kept as they are; what decays is balanced and truncated (B. C. Moore, Principal Component
   Analysis in Linear Systems, IEEE Trans. Automatic Control 26(1), 1981; the division by a real Schur form:
   A. Varga, Enhanced Modal Approach for Model Reduction, Mathematical Modelling of Systems 1(2), 1995).
3. It is sampled with hold, washouts by the bilinear transform as controllers have them, and Riccati's equations are
   solved for regulator and Kalman filter (G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems,
   3rd ed. 1998, 9). With the delay lag = (f + part) T the regulator acts on the state as it will be f frames on, which
   the setpoints on their way have settled: the optimum of the plant with its delay.

One BLAS thread at work: several may sum in another order, and processes of a graph must agree to the last bit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import block_diag, eigh, null_space, schur, solve_continuous_lyapunov, solve_sylvester
from threadpoolctl import threadpool_limits

from facts_damping.analysis.measures import measure_weights
from facts_damping.control.state_space import StateSpace
from facts_damping.errors import InputError
from facts_damping.plant.sampled import held_for, rigid
from facts_damping.signals import NANOSECONDS, to_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Controller
    from facts_damping.parameters.system import System
    from facts_damping.sensitivity import Sensitivity

DECAYS = 1e-2  # 1/s: what decays more slowly, or grows, is not truncated
DRIFTS = 1e-3  # 1/s: a mode as slow as this stands still
KEPT = 1e-3  # of the largest Hankel singular value: what has less is truncated
STILL = 1e-6  # p.u. or rad per p.u.: a signal that moves less beside the speed differences does not swing


class Model(NamedTuple):
    """dx = A x + B u + G w, y = C x + D u, z = Z x: setpoints u, torques w, signals y, speed differences z; p.u."""

    A: NDArray[np.float64]  # (states, states), 1/s
    B: NDArray[np.float64]  # (states, devices)
    G: NDArray[np.float64]  # (states, machines)
    C: NDArray[np.float64]  # (signals, states)
    D: NDArray[np.float64]  # (signals, devices)
    Z: NDArray[np.float64]  # (differences, states)

    def within(self, T: NDArray[np.float64], back: NDArray[np.float64]) -> Model:
        """The model in states z of x = T z, `back` T = 1."""
        return Model(back @ self.A @ T, back @ self.B, back @ self.G, self.C @ T, self.D, self.Z @ T)


def design(plant: Sensitivity | None, system: System, controller: Controller, here: str) -> StateSpace:
    """The controller's matrices. Raises `InputError` where the plant and its signals allow none; `here`: its field."""
    if plant is None:
        raise InputError(f"{here}.name: 'LQG' given, but the plant has no swing mode; allowed: LLC")
    with threadpool_limits(1):
        whole = model(plant, system, controller)
        rows = [plant.signals.index(name) for name in controller.signals]
        size = np.abs(plant.swing[rows]) / np.linalg.norm(whole.Z @ plant.shape)
        _check(plant, system, controller, size, here)
        limits = np.array([system.device(name).v_max for name in controller.devices])
        small = reduced(whole, plant.names, limits, size)
        if np.abs(np.linalg.eigvals(small.A)).min() < DRIFTS:
            raise InputError(
                f"{here}.signals: {', '.join(controller.signals)} given, which see a motion that nothing brings back "
                "(all speeds raised alike); allowed: for LQG differences of speeds, or signals with a washout"
            )
        step = sampled(small, plant.frame_rate, controller.number("lag"))
        effort, noise = controller.number("effort"), np.array(controller.parameters["noise"]) * size
        try:
            return optimal(small, step, plant.model.washout[rows], 1.0 / plant.frame_rate, limits, effort, noise)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(
                f"{here}: LQG given, but Riccati's equations have no solution: a mode that does not decay is not seen "
                f"in {', '.join(controller.signals)} or not moved by {', '.join(controller.devices)}; "
                "allowed: signals and devices that see and move all such modes"
            ) from error


def _check(plant: Sensitivity, system: System, controller: Controller, size: NDArray[np.float64], here: str) -> None:
    """Signals come back to zero at rest, and swing."""
    for i, (name, swing) in enumerate(zip(controller.signals, size, strict=True)):
        signal = system.signals[name]
        if signal.channel != "speed_deviation" and signal.washout == 0.0:
            raise InputError(
                f"{here}.signals.{i}: '{name}' given, which does not come back to zero at rest; "
                "allowed: for LQG speed deviations, or signals with a washout"
            )
        if not swing > STILL:
            raise InputError(
                f"{here}.signals.{i}: '{name}' given, which does not swing at the least damped mode "
                f"({plant.frequency_hz:.2f} Hz); allowed: signals that do"
            )


def model(plant: Sensitivity, system: System, controller: Controller) -> Model:
    """The linearised plant as a controller meets it; signals before their washouts."""
    rows = [plant.signals.index(name) for name in controller.signals]
    columns = [plant.devices.index(name) for name in controller.devices]
    machine = {station.name: station.machine for station in system.stations}
    differences = measure_weights({"system": system.model_dump(by_alias=True)}).values()
    G, Z = np.zeros((len(plant.names), len(system.machines))), np.zeros((len(differences), len(plant.names)))
    for i, one in enumerate(system.machines):
        G[plant.names.index(f"{one.name}.omega"), i] = 1.0 / (2.0 * one.H)
    for i, weights in enumerate(differences):
        for station, weight in weights.items():
            Z[i, plant.names.index(f"{machine[station]}.omega")] += weight
    own = plant.model
    return Model(own.A, own.B[:, columns], G, own.C[rows], own.D[np.ix_(rows, columns)], Z)


def reduced(whole: Model, names: Sequence[str], limits: NDArray[np.float64], size: NDArray[np.float64]) -> Model:
    """The model without rigid motions, and what decays truncated; signals count by their `size`, setpoints by limits.

    With x = W z, W from a real Schur form and Sylvester's equation, what decays goes by itself.
    """
    free = null_space(rigid(whole.A, np.vstack([whole.C, whole.Z]), names).T)
    seen = whole.within(free, free.T)
    form, turned, stays = schur(seen.A, sort=lambda real, _imaginary: real > -DECAYS)
    last = len(form) - stays
    cross = solve_sylvester(form[:stays, :stays], -form[stays:, stays:], -form[:stays, stays:])
    upper = np.block([[np.eye(stays), cross], [np.zeros((last, stays)), np.eye(last)]])
    divided = seen.within(turned @ upper, (2.0 * np.eye(len(form)) - upper) @ turned.T)
    decaying = divided.within(np.eye(len(form))[:, stays:], np.eye(len(form))[stays:])
    inputs, outputs = np.hstack([decaying.B * limits, decaying.G]), np.vstack([decaying.C / size[:, None], decaying.Z])
    T, back = balancing(decaying.A, inputs, outputs)
    return divided.within(block_diag(np.eye(stays), T), block_diag(np.eye(stays), back))


def balancing(
    A: NDArray[np.float64], B: NDArray[np.float64], C: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """T (states, kept) and back: x = T z, z the balanced states with a Hankel singular value of KEPT and more."""
    reach = _root(solve_continuous_lyapunov(A, -B @ B.T))
    observe = _root(solve_continuous_lyapunov(A.T, -C.T @ C))
    left, values, right = np.linalg.svd(observe.T @ reach)
    kept = int(np.sum(values >= KEPT * values.max(initial=0.0)))
    scale = 1.0 / np.sqrt(values[:kept])
    return reach @ right[:kept].T * scale, (observe @ left[:, :kept] * scale).T


def _root(gramian: NDArray[np.float64]) -> NDArray[np.float64]:
    """S of S S^T = P."""
    values, vectors = eigh((gramian + gramian.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


class Frames(NamedTuple):
    """x(k+1) = Phi x(k) + old u(k-f-1) + new u(k-f) + torque w(k): a model from frame to frame with its delay."""

    Phi: NDArray[np.float64]  # (states, states)
    old: NDArray[np.float64]  # (states, devices)
    new: NDArray[np.float64]  # (states, devices)
    torque: NDArray[np.float64]  # (states, machines)
    f: int


def sampled(small: Model, frame_rate: int, lag: float) -> Frames:
    """A model sampled with hold, its setpoints late by `lag`, s; exact (K. J. Astrom, B. Wittenmark, 1997, 2.3)."""
    period, devices = 1.0 / frame_rate, small.B.shape[1]
    f, rest = divmod(to_ns(lag) * frame_rate, NANOSECONDS)
    part = rest / NANOSECONDS * period
    onward, new = held_for(small.A, small.B, period - part)
    Phi, both = held_for(small.A, np.hstack([small.B, small.G]), period)
    return Frames(Phi, onward @ held_for(small.A, small.B, part)[1], new, both[:, devices:], f)


def optimal(
    small: Model,
    step: Frames,
    washout: NDArray[np.float64],
    period: float,
    limits: NDArray[np.float64],
    effort: float,
    noise: NDArray[np.float64],
) -> StateSpace:
    """Regulator and filter; states are the model's, those of the washouts, then setpoints u(k-1) to u(k-f-1).

    `washout`, s, and `noise`, standard deviation, of each signal; `effort`, of a setpoint at its limit, p.u.^2.
    """
    through, pole, pick = washouts(washout, period)
    own, devices = len(step.Phi) + len(pole), len(limits)
    ends = np.cumsum([len(step.Phi), len(pole), *[devices] * (step.f + 1)])
    x, faded, *sent = np.split(np.eye(ends[-1] + devices), ends)  # rows that pick each part
    sent = [sent[-1], *sent[:-1]]  # u(k) to u(k-f-1)
    raw = small.C @ x + small.D @ sent[-1]
    y = through @ (raw - pick.T @ faded)
    moved = step.Phi @ x + step.old @ sent[-1] + step.new @ sent[step.f]
    after = np.vstack([moved, pole @ faded + (np.eye(len(pole)) - pole) @ pick @ raw, *sent[:-1]])
    ahead = x  # as it will be f frames on
    for i in range(step.f, 0, -1):
        ahead = step.Phi @ ahead + step.old @ sent[i + 1] + step.new @ sent[i]

    torque = np.vstack([step.torque, np.zeros((len(pole), step.torque.shape[1]))])
    M = np.zeros((ends[-1], len(noise)))
    rest = np.asarray(np.linalg.solve(np.eye(own) - after[:own, :own], torque), np.float64)  # by a step of each torque
    M[:own] = _filter(after[:own, :own], rest, y[:, :own], noise)
    K = _regulator(step, small.Z, limits, effort) @ np.vstack([ahead, sent[1]])
    n = ends[-1]
    return StateSpace(after[:, :n], after[:, n:], y[:, :n], M, K[:, :n])


def washouts(
    washout: NDArray[np.float64], period: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Washouts by the bilinear transform, p s(k) + (1 - p) y(k) = s(k+1), g (y - s) in the place of y.

    g of all signals (1 without one), p of those that have one, and the rows that pick these.
    """
    twice = 2.0 * washout / period
    has = washout > 0.0
    return (
        np.diag(np.where(has, twice / (1.0 + twice), 1.0)),
        np.diag(((twice - 1.0) / (twice + 1.0))[has]),
        np.eye(len(washout))[has],
    )


def _filter(
    A: NDArray[np.float64], G: NDArray[np.float64], C: NDArray[np.float64], noise: NDArray[np.float64]
) -> NDArray[np.float64]:
    """M of the Kalman filter, P C^T (C P C^T + R)^-1, with signals in units of their noise."""
    from control import dlqe  # noqa: PLC0415 (slow to load, seldom asked for)

    seen, one = C / noise[:, None], np.eye(len(noise))
    _, P, _ = dlqe(A, G, seen, np.eye(G.shape[1]), one, method="scipy")
    return np.asarray(np.linalg.solve(seen @ P @ seen.T + one, seen @ P).T / noise)


def _regulator(step: Frames, Z: NDArray[np.float64], limits: NDArray[np.float64], effort: float) -> NDArray[np.float64]:
    """K of u(k) = -K [x(k+f), u(k-1)], with setpoints in units of their limits."""
    from control import dlqr  # noqa: PLC0415 (as above)

    n, devices = step.new.shape
    A = np.block([[step.Phi, step.old * limits], [np.zeros((devices, n + devices))]])
    B = np.vstack([step.new * limits, np.eye(devices)])
    Q = block_diag(Z.T @ Z, np.zeros((devices, devices)))
    K, _, _ = dlqr(A, B, Q / effort, np.eye(devices), method="scipy")
    return np.asarray(limits[:, None] * K / np.concatenate([np.ones(n), limits]))
