"""Poles of damped waves from their samples: matrix pencil, Prony, and the Eigensystem Realization Algorithm.

Each method models the samples as `x_k = sum_i a_i z_i^k`, where several signals share the poles z and have amplitudes a
of their own. The number of poles comes from the singular values of the signals' Hankel matrices, for all methods alike.

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

CLEAN = 1e-11  # of the largest singular value: below it there is rounding only
NOISE = 4.0  # times the median singular value: below it there is noise only
OVERFLOW = 1e100  # a pole that grows or shrinks so much over the samples is no mode
MAX_ORDER = 24  # poles, also the useless ones
ERA_BLOCKS = 150  # rows and columns of ERA's Hankel matrix: 30 s at 10 samples/s, its SVD grows with their cube


def pencil(signals: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Right singular vectors (rows) of the signals' Hankel matrices, and how many stand out of the noise.

    `signals`: (samples, n). The Hankel matrices of the signals stand below each other, for they share
    their poles.
    """
    length = len(signals) // 3
    hankel = np.concatenate([np.lib.stride_tricks.sliding_window_view(x, length + 1) for x in signals.T])
    # By way of the triangular factor, which has the same values and vectors and is smaller.
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
    """The `order` roots most needed of `sum_j c_j z^j`, j = 0..L, where `sum_j c_j x_(k+j) = 0` predicts the samples.

    Linear prediction of order L, a third of the samples, by total least squares: of all c with c_L = 1 that are
    orthogonal to the signals' singular vectors, the shortest. The L - order roots that the signals do not need lie
    inside the unit circle. A Gauss-Newton step follows: noise scatters the roots of linear prediction up to twice as
    much as the Cramer-Rao bound, after it hardly more.
    """
    V = right[:order].T
    predictor = np.eye(len(V))[-1] - V @ V[-1]  # last unit vector, less what the signals contain of it
    roots = within(np.asarray(np.roots(predictor[::-1]), np.complex128), len(signals))
    inverse = np.linalg.pinv(amplitudes(roots, signals)[0])
    # By how much the residual rises without each root, not its energy: useless ones that lie close cancel each other.
    needed = np.sum(np.abs(inverse @ signals) ** 2, axis=1) / np.sum(np.abs(inverse) ** 2, axis=1)
    floor = np.sort(needed)[::-1][min(order, len(needed)) - 1]
    # A pair is needed alike but for rounding: where the limit would part it, both stay.
    kept = np.asarray(roots[needed >= 0.99 * floor], np.complex128)
    return improved(kept, signals)


def era_poles(signals: NDArray[np.float64], order: int) -> NDArray[np.complex128]:
    """Eigenvalues of the state matrix of ERA's balanced realisation, as python-control has it.

    The signals (samples, n) count as impulse response of a system with n outputs: `x_k = C A^k B`. Of more than 30 s
    at 10 samples/s the first 30 s count.
    """
    from control import eigensys_realization  # noqa: PLC0415 (slow to load, seldom asked for)

    blocks = min(len(signals) // 2, ERA_BLOCKS)
    response = np.concatenate([np.zeros((1, signals.shape[1])), signals])  # its first sample counts as feedthrough
    system, _ = eigensys_realization(response.T[:, np.newaxis, :], order, m=blocks, n=blocks)
    return np.asarray(np.linalg.eigvals(system.A), np.complex128)


# From signals (samples, n), their singular vectors (rows) and the number of poles to these.
METHODS: dict[str, Method] = {
    "matrix_pencil": lambda _, right, order: pencil_poles(right, order),
    "prony": prony_poles,
    "era": lambda signals, _, order: era_poles(signals, order),
}


def within(z: NDArray[np.complex128], samples: int) -> NDArray[np.complex128]:
    """Poles that neither grow nor shrink beyond numbers over so many samples."""
    growth = np.abs(z) ** samples
    return z[(growth < OVERFLOW) & (growth > 1 / OVERFLOW)]


def amplitudes(
    z: NDArray[np.complex128], signals: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Powers of the poles (samples, poles), each of norm 1, and their amplitudes in the signals (poles, n).

    Fit of least squares; the norm, because a pole that grows fast would hide the others from it.
    """
    powers = z[np.newaxis, :] ** np.arange(len(signals))[:, np.newaxis]
    powers /= np.linalg.norm(powers, axis=0)
    return powers, np.asarray(np.linalg.lstsq(powers, signals, rcond=None)[0], np.complex128)
