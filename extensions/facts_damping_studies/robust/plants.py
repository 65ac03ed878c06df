"""A plant of few states for the tuning of controllers: modes that decay are balanced and truncated.

The truncation's error is at most twice the sum of the Hankel singular values that are left out (K. Glover, All Optimal
Hankel-norm Approximations of Linear Multivariable Systems, International Journal of Control 39(6), 1984).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_continuous_lyapunov

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping_studies.robust.modal_plants import ModalPlant

    Array = NDArray[np.float64]

STAYS = 0.02  # 1/s: modes with slower decay, or growth, are not truncated
KEPT = 1e-3  # of the largest Hankel singular value: states with smaller values are truncated


class ReducedPlant(NamedTuple):
    """dx/dt = A x + B u, y = C x + D u, speed differences Z x; x after a step of a torque is a column of R."""

    A: Array  # (states, states), 1/s
    B: Array  # (states, devices)
    C: Array  # (signals, states)
    D: Array  # (signals, devices)
    R: Array  # (states, machines)
    Z: Array  # (differences, states)
    bound: float  # of the error, of signals in their swing per setpoint at its limit


def reduced(plant: ModalPlant, limits: Array) -> ReducedPlant:
    """The plant of few states; setpoints count by their limits (p.u.), signals and differences by their swing."""
    A, B, C, R, Z = plant.real()
    moving = np.diag(A) < -STAYS  # both states of a complex mode, whose block has its real part twice
    decays, rest = np.flatnonzero(moving), np.flatnonzero(~moving)
    size = np.abs(plant.response(2j * np.pi * 0.5)).max(axis=1)
    rows = np.vstack([C / np.where(size > 0.0, size, 1.0)[:, None], Z / np.abs(Z).max(initial=1e-300)])
    columns = np.hstack([B * limits, R / np.abs(R).max(initial=1e-300)])
    T, back, bound = balanced(A[np.ix_(decays, decays)], columns[decays], rows[:, decays])
    into = block_diag(np.eye(len(rest)), back)
    out = block_diag(np.eye(len(rest)), T)
    order = np.concatenate([rest, decays])
    A, B, R = A[np.ix_(order, order)], B[order], R[order]
    return ReducedPlant(into @ A @ out, into @ B, C[:, order] @ out, plant.D, into @ R, Z[:, order] @ out, bound)


def balanced(A: Array, B: Array, C: Array, most: int | None = None) -> tuple[Array, Array, float]:
    """T and back with x = T z, z balanced, of the states with a Hankel singular value of at least KEPT, or `most`.

    Also the bound of the error: twice the sum of the values left out. Method: square roots of the Gramians (M. S.
    Tombs, I. Postlethwaite, Truncated Balanced Realization of a Stable Non-minimal State-space System, 1987).
    """
    if not len(A):
        return np.zeros((0, 0)), np.zeros((0, 0)), 0.0
    reach, observe = (_root(solve_continuous_lyapunov(a, -b @ b.T)) for a, b in ((A, B), (A.T, C.T)))
    left, values, right = np.linalg.svd(observe.T @ reach)
    order = int(np.sum(values >= KEPT * values.max(initial=0.0)))
    order = order if most is None else min(order, most)
    scale = 1.0 / np.sqrt(values[:order])
    return reach @ right[:order].T * scale, (observe @ left[:, :order] * scale).T, 2.0 * float(values[order:].sum())


def _root(P: Array) -> Array:
    values, vectors = np.linalg.eigh((P + P.T) / 2.0)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
