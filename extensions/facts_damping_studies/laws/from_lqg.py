"""An observer's law from the linear plant, by the two Riccati equations of an LQG at the frame rate, without a delay.

The criterion, the disturbances and the noise are those of `small_signal.lqg`, but the delay is left to the prediction
by the measured age; for a constant delay of whole frames and PMUs without a filter both laws are the same.

- Washouts are states: df/dt = (y - f) / Tw, of which y - f is the signal.
- A mode exp(lambda t) comes through a PMU's filter with the factor sum_j g_j exp(-lambda (j / rate - latency)),
  relative to the instant of the frame, so the filter has no states. The signal of a washout gets what setpoints add
  within the filter's window; the washout's own state gets the filter's gain at rest.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import InputError
from facts_damping.numerics.phasors import magnitudes
from facts_damping.small_signal.lqg import (
    DesignModel,
    filter_gain,
    model,
    reduced,
    regulator_gain,
    sampled,
    without_integrals,
)
from facts_damping_studies.laws.observer_law import ObserverLaw

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Complex1, Complex2, Float1, Float2
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller
    from facts_damping.small_signal.residues import Residues
    from facts_damping.small_signal.sampled_output import Filtered

STILL = 1e-6  # p.u., standard deviation of the least noise that innovations are compared with
APART = 1e-10  # relative to A: by so much poles are moved apart where eigenvectors are too close
CLOSE = 1e7  # condition number of the eigenvectors from which they are


class Criterion(NamedTuple):
    """What a law is optimal for."""

    limits: Float1  # (devices,), p.u.
    control_weight: float  # of a setpoint at its limit, p.u.^2
    noise: Float1  # (signals,), standard deviation, p.u.
    frame_rate: int


class Modes(NamedTuple):
    """x = Re(V z), z = W x: one z for each pair of complex modes, and for each real one."""

    poles: Complex1
    V: Complex2  # (states, modes)
    W: Complex2  # (modes, states)


def from_lqg(plant: Residues, system: System, controller: Controller, downlink_s: Float1) -> ObserverLaw:
    """The law with the `control_weight` and `measurement_noise` of an LQG; `downlink_s`: (devices,), with dead times.

    Raises `InputError` if Riccati's equations have no solution.
    """
    rows = [plant.signals.index(name) for name in controller.signals]
    whole = model(plant, system, controller)
    size = magnitudes(plant.mode_shape[rows]) / np.linalg.norm(magnitudes(whole.Z @ plant.shape))
    whole, names = without_integrals(whole, plant.names, system)
    limits = np.array([system.device(name).setpoint_max for name in controller.devices])
    filters, seen = plant.model.filtered, size
    if filters is not None:
        filters = filters.of(rows)
        seen = magnitudes(filters.C @ plant.shape) * size / magnitudes(plant.mode_shape[rows])
    small = reduced(whole, names, limits, seen)
    if filters is not None:
        filters = filters._replace(C=small.C, D=small.D)
        small = through(small, filters)
    noise = np.array(controller.parameters["measurement_noise"]) * size
    criterion = Criterion(limits, controller.number("control_weight"), noise, plant.frame_rate)
    return observer_law(washed(small, plant.model.washout[rows]), criterion, downlink_s, filters)


def observer_law(
    small: DesignModel, criterion: Criterion, downlink_s: Float1, filters: Filtered | None = None
) -> ObserverLaw:
    """The law for a plant with its signals as controllers receive them; `filters` has C of its first states, and D."""
    limits, weight, noise, frame_rate = criterion
    step = sampled(small, frame_rate, 0.0)
    try:
        K = regulator_gain(step, small.Z, limits, weight)[:, : len(small.A)]
        rest = np.linalg.solve(small.A, -small.G).astype(np.float64)  # equilibrium after a step of each torque
        M = filter_gain(step.Phi, rest, small.C, noise)
    except np.linalg.LinAlgError as error:
        problem = "a plant with an undamped mode given that is not observable or not controllable"
        raise InputError(f"laws: {problem}; allowed: signals and devices for which all such modes are") from error
    S = np.linalg.solve(np.eye(len(noise)) - small.C @ M, np.diag((STILL * noise / noise.min()) ** 2))
    modes = modal(small.A)
    C = small.C @ modes.V
    seen = C, small.D, np.ones((len(C), 1)), np.zeros(1)
    if filters is not None:
        offsets = filters.delay - np.arange(filters.taps.shape[1]) / filters.rate
        seen = filters.C @ modes.V[: filters.C.shape[1]], filters.D, filters.taps, offsets
    parts = modes.W @ M, K @ modes.V, (S + S.T) / 2.0
    return ObserverLaw(modes.poles, modes.W @ small.B, C, *seen, *parts, downlink_s, frame_rate)


def washed(small: DesignModel, washout: Float1) -> DesignModel:
    """A plant with the washouts (s; 0: none) of its signals."""
    has = washout > 0.0
    pick, pole = np.eye(len(washout))[has], 1.0 / washout[has][:, None]
    n, extra = len(small.A), int(has.sum())
    A = np.block([[small.A, np.zeros((n, extra))], [pole * (pick @ small.C), -np.diag(pole[:, 0])]])
    B = np.vstack([small.B, pole * (pick @ small.D)])
    G = np.vstack([small.G, np.zeros((extra, small.G.shape[1]))])
    C, Z = np.hstack([small.C, -pick.T]), np.hstack([small.Z, np.zeros((len(small.Z), extra))])
    return DesignModel(A, B, G, C, small.D, Z)


def through(small: DesignModel, filters: Filtered) -> DesignModel:
    """A plant with signals as PMUs with a filter report them for their instant; `filters` has its C and D."""
    modes = modal(small.A)
    factors = np.array([filters.gain(pole) * np.exp(pole * filters.delay) for pole in modes.poles]).T
    C: Float2 = (factors * (filters.C @ modes.V) @ modes.W).real
    return small._replace(C=C, D=filters.gain(0.0).real[:, None] * filters.D)


def modal(A: Float2) -> Modes:
    """Modes of a matrix, with poles that are moved apart where they are too close to have eigenvectors."""
    poles, V = np.linalg.eig(A)
    if np.linalg.cond(V) > CLOSE:
        anything = np.random.default_rng(0).normal(size=A.shape)
        poles, V = np.linalg.eig(A + APART * np.linalg.norm(A, 2) * anything)
    W, chosen = np.linalg.inv(V), poles.imag >= 0.0
    twice = np.where(poles.imag > 0.0, 2.0, 1.0)
    return Modes(poles[chosen] + 0.0j, (twice * V)[:, chosen] + 0.0j, W[chosen] + 0.0j)
