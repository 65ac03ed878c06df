"""Damped waves with given poles: amplitudes, standard errors of the poles, and a step that improves them.

Also the quantile of Student's t for intervals.
"""

from __future__ import annotations

import math
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

POINTS = 50  # of Gauss's rule
RANK = 1e-12  # of the largest: smaller eigenvalues of the scaled normal equations are round-off


class Waves(NamedTuple):
    """A fit of `x_j(t) = sum_i Re(a_ij exp(s_i t)) + line_j` to signals x_j, with the poles s given."""

    s: NDArray[np.complex128]  # (waves,), 1/s: sigma + j omega, omega >= 0
    swings: NDArray[np.bool_]  # (waves,): whether omega > 0
    amplitude: NDArray[np.complex128]  # (waves, n), p.u., t from the first sample
    residual: NDArray[np.float64]  # (samples, n), p.u.
    slopes: NDArray[np.float64]  # (n, samples, parameters): derivatives by sigma, then by omega if > 0
    parameters: int  # fitted for each signal: amplitudes and line


def fit_waves(z: NDArray[np.complex128], signals: NDArray[np.float64], dt: float) -> Waves:
    """Waves of the poles z (conjugates included) in signals (samples, n) `dt` s apart, by linear least squares.

    The part of the derivatives that amplitudes and line can represent is removed (variable projection).
    """
    s = np.asarray(np.log(z[z.imag >= 0]) / dt, np.complex128)
    time = np.arange(len(signals)) * dt
    waves = np.exp(np.outer(time, s))
    norms = np.linalg.norm(waves, axis=0)
    waves /= norms
    swings = np.asarray(z[z.imag >= 0].imag > 0)
    line = np.column_stack([np.ones_like(time), np.linspace(-1, 1, len(time))])
    q, triangle = np.linalg.qr(np.column_stack([waves.real, waves.imag[:, swings], line]))
    coefficients = np.linalg.lstsq(triangle, q.T @ signals, rcond=None)[0]
    a = coefficients[: len(s)].astype(np.complex128)
    a[swings] -= 1j * coefficients[len(s) : len(s) + int(swings.sum())]
    moved = (time[:, np.newaxis] * waves) * a.T[:, np.newaxis, :]
    slopes = np.concatenate([moved.real, -moved.imag[..., swings]], axis=2)
    slopes -= q @ (q.T @ slopes)
    residual = signals - q @ (q.T @ signals)
    return Waves(s, swings, np.asarray(a / norms[:, np.newaxis], np.complex128), residual, slopes, q.shape[1])


def improved(z: NDArray[np.complex128], signals: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Poles after one Gauss-Newton step towards the joint least squares of poles and amplitudes.

    The given poles are kept if the step increases the residual. From good poles one step reaches the noise level. A
    pole that the samples hardly determine (slow, so that the line can represent it, or faint) would move far, so it is
    kept.
    """
    waves = fit_waves(z, signals, 1.0)
    step = _inverse(_normal(waves.slopes)) @ np.einsum("jkp,kj->p", waves.slopes, waves.residual)
    moves = step[: len(waves.s)].astype(np.complex128)
    moves[waves.swings] += 1j * step[len(waves.s) :]
    moves[np.abs(moves) > 1 / len(signals)] = 0.0  # resolution of that many samples
    upper = np.where(waves.swings, np.exp(waves.s + moves), z[z.imag >= 0] * np.exp(moves.real))
    better = np.concatenate([upper, upper[waves.swings].conj()])
    return better if _sum2(fit_waves(better, signals, 1.0).residual) < _sum2(waves.residual) else z


def errors(waves: Waves) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard errors of frequency (Hz) and damping ratio of each wave; NaN if there is none, or too few samples.

    With D_j the derivatives of signal j and v_j the variance of its residual, the covariance of sigma and omega is
    `G^-1 (sum_j v_j D_j' D_j) G^-1`, `G = sum_j D_j' D_j`: that of nonlinear least squares in white noise and, if all
    signals have the same noise, the Cramer-Rao bound. Other errors (a mode that changes with its amplitude, coloured
    noise) are not included.

    Source: G. H. Golub, V. Pereyra, The differentiation of pseudo-inverses and nonlinear least squares problems whose
    variables separate, SIAM J. Numer. Anal. 10 (1973) 413-432.
    """
    frequency, ratio = np.full((2, len(waves.s)), np.nan)
    signals, samples, poles = waves.slopes.shape
    free = samples - waves.parameters - poles / signals
    if free <= 0:
        return frequency, ratio
    weights = np.sqrt(np.sum(waves.residual**2, axis=0) / free)
    inverse = _inverse(_normal(waves.slopes))
    covariance = inverse @ _normal(weights[:, np.newaxis, np.newaxis] * waves.slopes) @ inverse
    for place, i in enumerate(np.flatnonzero(waves.swings)):
        both = np.array([i, len(waves.s) + place])
        pair_covariance = covariance[np.ix_(both, both)]
        sigma, omega = waves.s[i].real, waves.s[i].imag
        slope = np.array([-(omega**2), sigma * omega]) / abs(waves.s[i]) ** 3  # d(damping ratio)/d(sigma, omega)
        frequency[i] = np.sqrt(pair_covariance[1, 1]) / (2 * np.pi)
        ratio[i] = np.sqrt(slope @ pair_covariance @ slope)
    return frequency, ratio


def _normal(slopes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of D' D over the signals."""
    return np.asarray(np.einsum("jkp,jkq->pq", slopes, slopes))


def _inverse(G: NDArray[np.float64]) -> NDArray[np.float64]:
    """Inverse of the normal equations; scaled, because strong and faint waves differ by orders of magnitude."""
    scale = np.sqrt(np.maximum(np.diag(G), np.finfo(float).tiny))
    return np.asarray(np.linalg.pinv(G / np.outer(scale, scale), rcond=RANK, hermitian=True) / np.outer(scale, scale))


def _sum2(x: NDArray[np.float64]) -> float:
    return float(np.sum(x**2))


@cache
def _gauss() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points and weights of Gauss's rule, on -1 to 1."""
    return np.polynomial.legendre.leggauss(POINTS)


def student_quantile(free: float, probability: float) -> float:
    """Value below which Student's t with `free` degrees of freedom lies with a probability from 0.5 to 1.

    With t = sqrt(free) tan(a) the density of the angle is c cos(a)^(free - 1); Gauss's rule integrates it, and Newton's
    method solves for the probability. It agrees with SciPy to 1e-9; loading SciPy takes longer than a run.
    """
    density = math.exp(math.lgamma((free + 1) / 2) - math.lgamma(free / 2)) / math.sqrt(math.pi)
    x, weight = _gauss()
    angle = 0.0  # below the root; the density falls (from one degree on) or hardly rises
    for _ in range(100):
        below = density * angle / 2 * float(weight @ np.cos(angle * (x + 1) / 2) ** (free - 1))
        step = (probability - 0.5 - below) / (density * math.cos(angle) ** (free - 1))
        angle = min(angle + step, (angle + math.pi / 2) / 2)
        if abs(step) < 1e-14:
            break
    return math.sqrt(free) * math.tan(angle)
