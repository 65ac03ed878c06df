"""Closed loops of a controller in scenarios with delays: index, damping, and their gradients.

A controller z' = A_k z + B_k y, u = C_k z + D_k y is the matrix K = [A_k B_k; C_k D_k], so that the closed loop is
A + E K F: static feedback of a plant that has the controller's integrators (V. L. Syrmos et al., Static Output
Feedback, Automatica 33(2), 1997). The delay is a strictly proper Pade term of each device.

The index is the mean over torques of the ITSE of speed differences and of setpoints relative to their limits,

    J = tr(R^T Q_2 R),  A^T Q_1 + Q_1 A + Z^T Z = 0,  A^T Q_2 + Q_2 A + Q_1 = 0,

with the gradient 2 E^T (Q_2 P_1 + Q_1 P_2) F^T, where A P_1 + P_1 A^T + R R^T = 0 and A P_2 + P_2 A^T + P_1 = 0 (W. S.
Levine, M. Athans, On the Determination of the Optimal Constant Output Feedback Gains, IEEE Trans. Automatic Control
15(1), 1970, for the ISE). The gradient of a damping ratio is that of the eigenvalue, E^T w v^T F^T / (w v).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import pade
from scipy.linalg import block_diag, eig, schur
from scipy.linalg.lapack import dtrsyl
from scipy.signal import tf2ss

from facts_damping_studies.robust.modal_plants import in_band

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping_studies.robust.plants import ReducedPlant

    Array = NDArray[np.float64]

ORDER = 3  # of the denominator of a Pade term
MARGIN = 0.05  # 1/s: least decay as which a grid is judged that grows, so that its index without control exists


class Loop(NamedTuple):
    """A plant with the delay of its devices, in one scenario: dx/dt = A x + B u, y = C x."""

    A: Array  # (states, states), shifted by `shift`
    B: Array  # (states, devices), of setpoints relative to their limits
    C: Array  # (signals, states)
    R: Array  # (states, torques)
    Z: Array  # (differences, states)
    shift: float  # 1/s, subtracted from the diagonal of A
    index_without: float  # without control
    damping: float  # least damping ratio in the band without control
    effort: float  # weight of a setpoint at its limit beside a speed difference, p.u.^2


class Value(NamedTuple):
    """What a controller does in a loop; the gradient by K, (devices and states, signals and states)."""

    log_ratio: float  # ln of the square root of the index over that without control; infinite: unstable
    of_index: Array
    damping: float  # least damping ratio in the band less that without control


def delay_terms(delays: Sequence[float]) -> tuple[Array, Array, Array]:
    """A, B, C of strictly proper Pade terms of delays (s), one a device."""
    parts = [_term(delay) for delay in delays]
    A, B, C = (block_diag(*matrices) for matrices in zip(*parts, strict=True))
    return A, B, C


def _term(delay: float) -> tuple[Array, Array, Array]:
    series = np.cumprod(np.r_[1.0, -1.0 / np.arange(1.0, 2 * ORDER)])
    above, below = pade(series, ORDER, ORDER - 1)
    A, B, C, _ = tf2ss(above.coef, below.coef)
    return A / delay, B / delay, C


def loop(
    plant: ReducedPlant, limits: Array, delays: Sequence[float], masks: tuple[Array, Array], effort: float
) -> Loop:
    """The loop of a scenario; `delays` of each device (s), `masks`: 1 or 0 of each signal and device, in service."""
    signals, devices = masks
    a, b, c = delay_terms(delays)
    n, many = len(plant.A), len(a)
    A = np.block([[plant.A, plant.B * devices @ c], [np.zeros((many, n)), a]])
    B = np.vstack([np.zeros((n, len(limits))), b * limits])
    C = signals[:, None] * np.hstack([plant.C, plant.D * devices @ c])
    R = np.vstack([plant.R, np.zeros((many, plant.R.shape[1]))])
    Z = np.hstack([plant.Z, np.zeros((len(plant.Z), many))])
    values = np.linalg.eigvals(A)
    shift = max(0.0, float(values.real.max()) + MARGIN)
    bare = Loop(A - shift * np.eye(len(A)), B, C, R, Z, shift, 1.0, 0.0, effort)
    index = _index(bare, np.zeros((len(limits), len(signals))), 0, gradient=False)[0]
    return bare._replace(index_without=index, damping=float(_damping(values).min(initial=1.0)))


def _damping(values: NDArray[np.complex128]) -> Array:
    """Damping ratios in the band; 1 of other modes."""
    ratios: Array = np.where(in_band(values), -values.real / np.maximum(np.abs(values), 1e-12), 1.0)
    return ratios


def closed(loop: Loop, K: Array, states: int) -> tuple[Array, Array, Array]:
    """A + E K F, E and F; K = [A_k B_k; C_k D_k] with `states` of the controller, which are the last."""
    n, devices, signals = len(loop.A), loop.B.shape[1], len(loop.C)
    E = np.block([[np.zeros((n, states)), loop.B], [np.eye(states), np.zeros((states, devices))]])
    F = np.block([[np.zeros((states, n)), np.eye(states)], [loop.C, np.zeros((signals, states))]])
    A = block_diag(loop.A, -loop.shift * np.eye(states)) + E @ K @ F
    return A, E, F


def value(loop: Loop, K: Array, states: int, *, gradient: bool = True) -> Value:
    """What a controller does in a loop."""
    index, of_index, values = _index(loop, K, states, gradient=gradient)
    if not np.isfinite(index):
        return Value(np.inf, of_index, -np.inf)
    least = float(_damping(values + loop.shift).min(initial=1.0))
    return Value(0.5 * np.log(index / loop.index_without), 0.5 * of_index / index, least - loop.damping)


def _index(loop: Loop, K: Array, states: int, *, gradient: bool) -> tuple[float, Array, NDArray[np.complex128]]:
    """The index, its gradient by K, and the eigenvalues; infinite if the loop is unstable."""
    A, E, F = closed(loop, K, states)
    T, U = schur(A)
    values = _block_eigenvalues(T)
    if values.real.max() >= 0.0:
        return np.inf, np.zeros_like(K), values
    R = U.T @ np.vstack([loop.R, np.zeros((states, loop.R.shape[1]))])
    Z = np.hstack([loop.Z, np.zeros((len(loop.Z), states))]) @ U
    of_setpoints = K[states:] @ F @ U
    weight = Z.T @ Z + loop.effort * of_setpoints.T @ of_setpoints
    Q_1 = _lyapunov(T, weight, transposed=True)
    Q_2 = _lyapunov(T, Q_1, transposed=True)
    index = float(np.einsum("ij,ij->", R, Q_2 @ R))
    if not gradient:
        return index, np.zeros_like(K), values
    P_1 = _lyapunov(T, R @ R.T, transposed=False)
    P_2 = _lyapunov(T, P_1, transposed=False)
    FU = F @ U
    of_K = 2.0 * (U.T @ E).T @ (Q_2 @ P_1 + Q_1 @ P_2) @ FU.T
    of_K[states:] += 2.0 * loop.effort * of_setpoints @ P_2 @ FU.T
    return index, of_K, values


def _block_eigenvalues(T: Array) -> NDArray[np.complex128]:
    """Eigenvalues of a real Schur form, whose blocks have equal diagonals, with a non-negative imaginary part."""
    square = np.zeros(len(T))
    square[:-1] = np.diag(T, 1) * np.diag(T, -1)
    values: NDArray[np.complex128] = np.diag(T) + 1j * np.sqrt(np.maximum(-square, 0.0))
    return values


def _lyapunov(T: Array, W: Array, *, transposed: bool) -> Array:
    """X of T X + X T^T + W = 0, or of T^T X + X T + W = 0, for a real Schur form."""
    trana, tranb = ("T", "N") if transposed else ("N", "T")
    X, scale, _ = dtrsyl(T, T, -W, trana=trana, tranb=tranb)
    solution: Array = X * scale
    return solution


def damping(loop: Loop, K: Array, states: int) -> tuple[float, Array]:
    """The least damping ratio in the band, and its gradient by K."""
    A, E, F = closed(loop, K, states)
    A = A + loop.shift * np.eye(len(A))
    values, left, right = eig(A, left=True, right=True)
    ratios = _damping(values)
    i = int(np.argmin(ratios))
    if ratios[i] == 1.0:
        return 1.0, np.zeros_like(K)
    w, v, at = left[:, i].conj(), right[:, i], values[i]
    of_value = np.outer(E.T @ w, F @ v) / (w @ v)
    size = abs(at)
    along = at.real * (at.conjugate() * of_value).real / size**3
    gradient: Array = -of_value.real / size + along
    return float(ratios[i]), gradient
