"""Controllers by Riccati's equations for one loop, reduced by balanced truncation: starts for tuning, and laws.

- LQG: the state feedback minimises the integral of squared speed differences and setpoints, the filter the error of the
  states for steps of torques and white noise of the signals (B. D. O. Anderson, J. B. Moore, Optimal Control, 1990).
- H-infinity: loop shaping, the largest robustness of normalised coprime factors (D. McFarlane, K. Glover, A Loop
  Shaping Design Procedure Using H-infinity Synthesis, IEEE Trans. Automatic Control 37(6), 1992), of the whole plant.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import solve_continuous_are

from facts_damping.control.linear_law import Matrices
from facts_damping.small_signal.loop_shaping import series, washouts
from facts_damping_studies.robust.plants import balanced

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping_studies.robust.loops import Loop

    Array = NDArray[np.float64]

WASHOUT = 10.0  # s
ABOVE = 1.1  # gamma over the least one


class Compensator(NamedTuple):
    """A law as K = [A B; C D], its number of states, and the bound of its error, relative to its largest gain."""

    K: Array
    states: int
    bound: float


def lqg(loop: Loop, effort: float, noise: Array, torque: float) -> Compensator:
    """The LQG law of a loop; `noise`: (signals,), density, `torque`: rms of steps of torques in a second, p.u."""
    n, devices = loop.B.shape
    X = solve_continuous_are(loop.A, loop.B, loop.Z.T @ loop.Z + 1e-12 * np.eye(n), effort * np.eye(devices))
    F = loop.B.T @ X / effort
    W = torque**2 * loop.R @ loop.R.T + 1e-12 * np.eye(n)
    Y = solve_continuous_are(loop.A.T, loop.C.T, W, np.diag(noise**2))
    L = Y @ loop.C.T / noise**2
    A = loop.A - loop.B @ F - L @ loop.C
    return Compensator(np.block([[A, L], [-F, np.zeros((devices, len(loop.C)))]]), n, 0.0)


def h_infinity(loop: Loop, gain: float) -> Compensator:
    """The H-infinity law of a loop that is shaped by a gain (limits per size of a signal) and a washout."""
    devices = loop.B.shape[1]
    weights = washouts(np.full(devices, gain), np.full(devices, WASHOUT))
    shaped = series(weights, Matrices(loop.A, loop.B, loop.C, np.zeros((len(loop.C), devices))))
    A, B, C, _ = shaped
    X = solve_continuous_are(A, B, C.T @ C, np.eye(devices))
    Z = solve_continuous_are(A.T, C.T, B @ B.T, np.eye(len(C)))
    gamma = ABOVE * float(np.sqrt(1.0 + np.abs(np.linalg.eigvals(X @ Z)).max()))
    L = (1.0 - gamma**2) * np.eye(len(A)) + X @ Z
    H = gamma**2 * np.linalg.solve(L.T, Z @ C.T)
    F = B.T @ X
    robust = Matrices(A - B @ F + H @ C, H, F, np.zeros((devices, len(C))))
    whole = series(robust, weights)
    return Compensator(np.block([[whole.A, whole.B], [whole.C, whole.D]]), len(whole.A), 0.0)


def of_order(law: Compensator, most: int) -> Compensator | None:
    """A law of at most some states, by balanced truncation of its part that decays; None: it has another part."""
    n = law.states
    A, B, C, D = law.K[:n, :n], law.K[:n, n:], law.K[n:, :n], law.K[n:, n:]
    if np.linalg.eigvals(A).real.max() >= 0.0:
        return None
    T, back, bound = balanced(A, B, C, most)
    K = np.block([[back @ A @ T, back @ B], [C @ T, D]])
    return Compensator(K, T.shape[1], bound)
