"""Poles of damped waves from their samples: matrix pencil, Prony, and the Eigensystem Realization Algorithm.

Each method models the samples as `x_k = sum_i a_i z_i^k`; several signals share the poles z and have their own
amplitudes. For all methods the number of poles comes from the singular values of the signals' Hankel matrices.

Sources: Y. Hua, T. K. Sarkar, Matrix pencil method for estimating parameters of exponentially damped/undamped sinusoids
in noise, IEEE Trans. ASSP 38 (1990) 814-824; several signals as in Crow and Singh, IEEE Trans. Power Systems 20 (2005)
501-502. Prony: J. F. Hauer, C. J. Demeure, L. L. Scharf, Initial results in Prony analysis of power system response
signals, IEEE Trans. Power Systems 5 (1990) 80-89; its linear prediction solved by total least squares in the signal
subspace as in M. A. Rahman, K.-B. Yu, IEEE Trans. ASSP 35 (1987) 1440-1454. ERA: J.-N. Juang, R. S. Pappa, J. Guidance
8 (1985) 620-627.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.modes.confidence import improved

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Method = Callable[[NDArray[np.float64], NDArray[np.float64], int], NDArray[np.complex128]]

CLEAN = 1e-11  # of the largest singular value; smaller ones are round-off
NOISE = 4.0  # times the median singular value; smaller ones are noise
OVERFLOW = 1e100  # largest growth or decay of a mode over the samples
MAX_ORDER = 24  # poles, spurious ones included
ERA_BLOCKS = 150  # rows and columns of ERA's Hankel matrix: 30 s at 10 samples/s; its SVD's cost grows with the cube


def pencil(signals: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Right singular vectors (rows) of the signals' Hankel matrices, and how many are above the noise.

    `signals`: (samples, n). The Hankel matrices are stacked, because the signals share their poles.
    """
    length = len(signals) // 3
    hankel = np.concatenate([np.lib.stride_tricks.sliding_window_view(x, length + 1) for x in signals.T])
    # Uses the triangular factor, which has the same values and vectors and is smaller.
    _, singular, right = np.linalg.svd(np.linalg.qr(hankel, mode="r"), full_matrices=False)
    floor = max(CLEAN * singular[0], NOISE * float(np.median(singular)))
    return right, min(int(np.sum(singular > floor)), MAX_ORDER, length - 1)


def pencil_poles(right: NDArray[np.float64], order: int) -> NDArray[np.complex128]:
    """Poles z of `x_k = sum_i a_i z_i^k`, i = 1..order: eigenvalues of `pinv(V[:-1]) V[1:]`.

    `right`: right singular vectors (rows) as from `pencil`; V holds the first `order` of them as columns.
    """
    V = right[:order].T
    return np.asarray(np.linalg.eigvals(np.linalg.lstsq(V[:-1], V[1:], rcond=None)[0]), np.complex128)


def prony_poles(signals: NDArray[np.float64], right: NDArray[np.float64], order: int) -> NDArray[np.complex128]:
    """The `order` most needed roots of `sum_j c_j z^j`, j = 0..L, where `sum_j c_j x_(k+j) = 0` predicts the samples.

    Linear prediction of order L, a third of the samples, by total least squares: of all c with c_L = 1 that are
    orthogonal to the signals' singular vectors, the shortest. The L - order spurious roots lie inside the unit circle.
    A Gauss-Newton step follows: noise scatters the roots of linear prediction up to twice as much as the Cramer-Rao
    bound, after the step hardly more.
    """
    V = right[:order].T
    predictor = np.eye(len(V))[-1] - V @ V[-1]  # last unit vector without its projection on the signals
    roots = within(np.asarray(np.roots(predictor[::-1]), np.complex128), len(signals))
    inverse = np.linalg.pinv(amplitudes(roots, signals)[0])
    # Ranked by the rise of the residual without each root, not by energy: close spurious roots cancel each other.
    needed = np.sum(np.abs(inverse @ signals) ** 2, axis=1) / np.sum(np.abs(inverse) ** 2, axis=1)
    floor = np.sort(needed)[::-1][min(order, len(needed)) - 1]
    # The roots of a conjugate pair rank equally but for round-off: if the limit would split a pair, both stay.
    needed_roots = np.asarray(roots[needed >= 0.99 * floor], np.complex128)
    return improved(needed_roots, signals)


def era_poles(signals: NDArray[np.float64], order: int) -> NDArray[np.complex128]:
    """Eigenvalues of the state matrix of ERA's balanced realisation by python-control.

    The signals (samples, n) are taken as impulse response of a system with n outputs: `x_k = C A^k B`. Only the first
    30 s at 10 samples/s are used.
    """
    from control import eigensys_realization  # noqa: PLC0415 (slow to load, seldom asked for)

    blocks = min(len(signals) // 2, ERA_BLOCKS)
    response = np.concatenate([np.zeros((1, signals.shape[1])), signals])  # its first sample is the feedthrough
    system, _ = eigensys_realization(response.T[:, np.newaxis, :], order, m=blocks, n=blocks)
    return np.asarray(np.linalg.eigvals(system.A), np.complex128)


# Methods: signals (samples, n), their singular vectors (rows) and the number of poles to poles.
METHODS: dict[str, Method] = {
    "matrix_pencil": lambda _, right, order: pencil_poles(right, order),
    "prony": prony_poles,
    "era": lambda signals, _, order: era_poles(signals, order),
}


def within(z: NDArray[np.complex128], samples: int) -> NDArray[np.complex128]:
    """Poles whose growth or decay over the samples does not overflow."""
    growth = np.abs(z) ** samples
    return z[(growth < OVERFLOW) & (growth > 1 / OVERFLOW)]


def amplitudes(
    z: NDArray[np.complex128], signals: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Powers of the poles (samples, poles), each of norm 1, and their amplitudes in the signals (poles, n).

    Least-squares fit; the norm prevents a fast growing pole from hiding the others.
    """
    powers = z[np.newaxis, :] ** np.arange(len(signals))[:, np.newaxis]
    powers /= np.linalg.norm(powers, axis=0)
    return powers, np.asarray(np.linalg.lstsq(powers, signals, rcond=None)[0], np.complex128)
