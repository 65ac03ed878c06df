"""H-infinity loop shaping: maximum robustness to errors of the normalised coprime factors of a shaped plant.

The plant is its least damped electromechanical mode alone, two states, from setpoints to signals, with a Pade term for
the loop delay. Weights shape it: `gain` and a washout before each device; signals are scaled by their swing relative
to the first. For the shaped plant (A, B, C), with X and Z the solutions of its two Riccati equations,

    least gamma = sqrt(1 + rho(X Z)),  gamma = above * least
    dx/dt = (A - B B^T X + H C) x + H y,  u = B^T X x,  H = gamma^2 L^-T Z C^T,  L = (1 - gamma^2) 1 + X Z

tolerates every error of the normalised coprime factors below 1 / gamma (K. Glover, D. McFarlane, Robust Stabilization
of Normalized Coprime Factor Plant Descriptions with H-infinity-Bounded Uncertainty, IEEE Trans. Automatic Control
34(8), 1989; S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. 2005, 9.4). The weights are part
of the final controller, at its output.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.control.linear_law import Matrices
from facts_damping.errors import InputError
from facts_damping.numerics.matrices import product, root, sign, singular, solve
from facts_damping.numerics.phasors import exponentials, magnitudes, over, times
from facts_damping.small_signal.own_linear import held

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1, Float2
    from facts_damping.control.state_space import StateSpace
    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Controller
    from facts_damping.small_signal.residues import Residues


def design(plant: Residues | None, system: System, controller: Controller, here: str) -> StateSpace:
    """The controller's matrices. Raises `InputError` if the plant has no electromechanical mode; `here`: its field."""
    if plant is None:
        raise InputError(
            f"{here}.name: '{controller.name}' given, but the plant has no electromechanical mode; allowed: LLC"
        )
    devices, rate = controller.devices, plant.frame_rate
    gain = np.broadcast_to(np.array(controller.parameters["gain"], float), len(devices))
    Tw = np.broadcast_to(np.array(controller.parameters["Tw"], float), len(devices))
    weights = washouts(gain, Tw)
    delay = max(0.0, controller.number("loop_delay")) + 0.5 / rate  # including that of the hold
    count = magnitudes([plant.ratio(name, controller.signals[0]) for name in controller.signals])
    mode = least_damped(plant, system, controller)
    counted = mode._replace(C=mode.C / count[:, None])
    shaped = series(weights, series(pade(delay, len(devices)), counted))
    robust, _ = tolerant(shaped, controller.number("above"))
    law = series(robust._replace(B=robust.B / count), weights)
    return held(*law, rate)


def least_damped(plant: Residues, system: System, controller: Controller) -> Matrices:
    """The least damped mode without delay: dz/dt = lambda z + b u, y = 2 Re(c z), in real states."""
    rows = [plant.signals.index(name) for name in controller.signals]
    columns = [plant.devices.index(name) for name in controller.devices]
    filtered = plant.model.filtered
    latency = 0.0 if filtered is None else filtered.delay
    known = [latency + system.device(name).dead_time for name in controller.devices]  # delays included in the residues
    residue = times(plant.residue[np.ix_(rows, columns)], exponentials(plant.eigenvalue * np.array(known)))
    c = plant.mode_shape[rows]
    b = over(residue[0], c[0])
    s, w = plant.eigenvalue.real, plant.eigenvalue.imag
    A = np.array([[s, -w], [w, s]])
    return Matrices(
        A, np.vstack([b.real, b.imag]), 2.0 * np.column_stack([c.real, -c.imag]), np.zeros((len(c), len(b)))
    )


def washouts(gain: Float1, Tw: Float1) -> Matrices:
    """The weight before each device: gain s Tw / (1 + s Tw)."""
    return Matrices(np.diag(-1.0 / Tw), np.diag(1.0 / Tw), np.diag(-gain), np.diag(gain))


def pade(delay: float, inputs: int) -> Matrices:
    """The Pade term of order 2 of a delay, s, of each input: (1 - s T/2 + s^2 T^2/12) / (1 + s T/2 + s^2 T^2/12)."""
    a0, a1 = 12.0 / (delay * delay), 6.0 / delay
    eye = np.eye(inputs)
    A = np.kron(eye, np.array([[0.0, 1.0], [-a0, -a1]]))
    return Matrices(A, np.kron(eye, np.array([[0.0], [1.0]])), np.kron(eye, np.array([[0.0, -2.0 * a1]])), eye)


def series(first: Matrices, second: Matrices) -> Matrices:
    """Series connection of the first system, then the second."""
    zero = np.zeros((len(first.A), len(second.A)))
    A = np.block([[first.A, zero], [product(second.B, first.C), second.A]])
    B = np.vstack([first.B, product(second.B, first.D)])
    return Matrices(A, B, np.hstack([product(second.D, first.C), second.C]), product(second.D, first.D))


def tolerant(shaped: Matrices, above: float) -> tuple[Matrices, float]:
    """The controller u = K y for `above` times the least gamma, and that gamma; the shaped plant has D = 0."""
    A, B, C, _ = shaped
    X, Z = continuous_riccati(A, B, C), continuous_riccati(A.T, C.T, B.T)
    _, values, _ = singular(product(root(X).T, root(Z)))  # singular values, whose squares are the eigenvalues of X Z
    gamma = above * math.sqrt(1.0 + float(values.max()) * float(values.max()))
    L = (1.0 - gamma * gamma) * np.eye(len(A)) + product(X, Z)
    H = gamma * gamma * solve(L.T, product(Z, C.T))
    F = product(B.T, X)
    return Matrices(A - product(B, F) + product(H, C), H, F, np.zeros((B.shape[1], C.shape[0]))), gamma


def continuous_riccati(A: Float2, B: Float2, C: Float2) -> Float2:
    """The stabilising X of A^T X + X A - X B B^T X + C^T C = 0, by the Hamiltonian's sign (J. D. Roberts, 1980)."""
    n, eye = len(A), np.eye(len(A))
    W = sign(np.block([[A, -product(B, B.T)], [-product(C.T, C), -A.T]]))
    left = np.vstack([W[:n, n:], W[n:, n:] + eye])
    right = -np.vstack([W[:n, :n] + eye, W[n:, :n]])
    X = solve(product(left.T, left), product(left.T, right))
    return np.asarray((X + X.T) / 2.0)
