"""Modes of a system excited only by noise: covariance-driven stochastic subspace identification (SSI-cov).

If noise drives a linear system, the covariances of its signals y over the lag l are those of free oscillations with the
system's own poles, `R_l = E[y(k+l) y(k)'] = C A^(l-1) G`. The block matrix `H_ij = R_(l0+i+j)` has the rank of the
system; its singular vectors give A, whose eigenvalues are the poles z = exp(s dt).

Standard errors follow from the infinitesimal jackknife over B blocks of time: with p_b the estimate from covariances in
which the weight of block b is reduced by the fraction e, `se^2 = (B - 1) / B sum_b ((p_b - mean p) / e)^2`.

Sources: P. van Overschee, B. De Moor, Subspace Identification for Linear Systems, Kluwer 1996, chapter 3; B. Peeters,
G. De Roeck, Reference-based stochastic subspace identification for output-only modal analysis, Mech. Syst. Signal
Process. 13 (1999) 855-878. Blocks of a dependent series: H. R. Kuensch, The jackknife and the bootstrap for general
stationary observations, Ann. Statist. 17 (1989) 1217-1241; infinitesimal: B. Efron, The Jackknife, the Bootstrap and
Other Resampling Plans, SIAM 1982, chapter 6.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from facts_damping.analysis.modes.oscillation import RESOLUTION
from facts_damping.analysis.modes.ringdown import BAND, Fit, RingdownMode, block_means, figures, without_line

if TYPE_CHECKING:
    from numpy.typing import NDArray

METHOD = "ssi"
MINIMUM = 60.0  # s; with less, intervals are meaningless
FIRST_LAG = 2  # samples; excludes measurement noise and the memory of filters up to 0.1 s
ROWS = 15  # block rows: lags up to 3 s; covariances at longer lags are mostly random
BLOCKS = 20  # of time
LESS = 0.1  # of a block's weight: small enough that poles keep their identity
ORDER, MIN_ORDER = 8, 4  # poles
FRACTION = 0.02  # of the variance of all signals; weaker modes are negligible
MAX_DAMPED = 0.3  # largest damping ratio of an oscillation
STRONG = 0.05  # of the variance: an uncertain mode stronger than this was split by noise, so there are too many poles
SURE = 0.1  # standard error of a damping ratio, and relative of a frequency; beyond it a pole is not reported


class _Poles(NamedTuple):
    """Model of covariances: poles, shapes and fractions, R_l = sum_i shape_i fraction_i z_i^(l - l0)."""

    z: NDArray[np.complex128]  # (poles,)
    shape: NDArray[np.complex128]  # (n, poles)
    fraction: NDArray[np.complex128]  # (poles, n)


def fit_ambient(time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0) -> Fit | None:
    """Modes of 0.1 to 2.5 Hz in the noise of a record, the strongest first.

    `time_s`: (ticks,), s, evenly spaced; `signals`: (ticks, n), p.u.; `since`: s, earlier samples do not count. The
    model has two poles per signal, because n speed differences have at most n modes, and two more for slow components,
    at least 8; fewer if a strong mode would be uncertain. A mode's `amplitude` is that of a steady wave of the same
    variance; `phase_rad` is relative to the signal in which the mode is largest; `snr_db` compares the covariances with
    the model's residual. None if less than a minute is left, a value is not finite, or nothing moves.
    """
    inside = time_s >= since
    x = np.reshape(signals, (len(time_s), -1))[inside]
    if len(x) < 2 or np.ptp(time_s[inside]) < MINIMUM - 1.0 or not np.isfinite(x).all():
        return None
    step = float(np.median(np.diff(time_s)))
    x, block = block_means(x, step)
    x = without_line(x)
    size = np.maximum(x.std(axis=0), RESOLUTION)  # a signal at rest is not scaled up
    if np.ptp(x, axis=0).max() < RESOLUTION:
        return None
    orders = range(max(ORDER, 2 * x.shape[1] + 2), MIN_ORDER - 1, -2)
    with threadpool_limits(1):  # as in `fit_ringdown`
        R = covariances(x / size)
        fits = []
        for order in orders:
            fits.append(_fit(R, order, size, block * step, block))
            if not any(_unsure(mode) and mode.energy >= STRONG for mode in fits[-1].modes):
                break
        else:
            del fits[1:]
    fit = fits[-1]
    return fit._replace(modes=[m for m in fit.modes if not _unsure(m)], start_s=float(time_s[inside][0]))


def _fit(R: NDArray[np.float64], order: int, size: NDArray[np.float64], dt: float, block: int) -> Fit:
    """Modes of a model of given order from the covariances of blocks, including uncertain ones."""
    whole = R.mean(axis=0)
    model = _identify(whole, order)
    less = [_identify(whole + LESS * (whole - block_covariance) / (BLOCKS - 1), order).z for block_covariance in R]
    left = whole - _covariances_of(model, len(whole))
    snr = 10 * np.log10(np.sum(whole**2) / max(np.sum(left**2), np.finfo(float).tiny))
    return Fit(_modes(model, less, size, dt, block), order, 0.0, float(snr))


def _unsure(mode: RingdownMode) -> bool:
    """Whether a mode's standard errors are too large to report it."""
    return max(mode.frequency_error_hz / mode.frequency_hz, mode.damping_ratio_error) > SURE


def covariances(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Covariances of signals (samples, n) at the lags used, for each block of time: (BLOCKS, lags, n, n)."""
    lags = range(FIRST_LAG, FIRST_LAG + 2 * ROWS)
    n = (len(x) - lags[-1]) // BLOCKS
    now = x[: n * BLOCKS].reshape(BLOCKS, n, -1)
    later = (x[lag : lag + n * BLOCKS].reshape(BLOCKS, n, -1) for lag in lags)
    return np.stack([y.transpose(0, 2, 1) @ now / n for y in later], axis=1)


def _identify(R: NDArray[np.float64], order: int) -> _Poles:
    """Poles of covariances (lags, n, n) from the shift between the block rows of O in H = O C."""
    n = R.shape[1]
    hankel = np.block([[R[i + j] for j in range(ROWS)] for i in range(ROWS)])
    u, s, v = np.linalg.svd(hankel)
    scale = np.sqrt(s[:order])
    rows, columns = u[:, :order] * scale, scale[:, np.newaxis] * v[:order]
    A = np.linalg.lstsq(rows[:-n], rows[n:], rcond=None)[0]
    z, eigenvectors = np.linalg.eig(A)
    return _Poles(z.astype(np.complex128), rows[:n] @ eigenvectors, np.linalg.solve(eigenvectors, columns[:, :n]))


def _covariances_of(model: _Poles, lags: int) -> NDArray[np.float64]:
    """Covariances of the model, (lags, n, n)."""
    powers = model.z ** np.arange(lags)[:, np.newaxis]
    return np.asarray(np.einsum("ji,li,ik->ljk", model.shape, powers, model.fraction).real)


def _modes(
    model: _Poles, less: list[NDArray[np.complex128]], size: NDArray[np.float64], dt: float, block: int
) -> list[RingdownMode]:
    """Modes within the band that are not negligible, the strongest first."""
    s = np.log(model.z) / dt
    modes = []
    for i in np.flatnonzero((s.imag >= 2 * np.pi * BAND[0]) & (s.imag <= 2 * np.pi * BAND[1])):
        variance = 2 * np.abs(model.shape[:, i] * model.fraction[i] * model.z[i] ** -FIRST_LAG)  # with its conjugate
        energy, (frequency, ratio) = float(variance.mean()), figures(s[i])
        near = np.array([figures(np.log(z[np.argmin(np.abs(z - model.z[i]))]) / dt) for z in less])
        frequency_error, ratio_error = (np.sqrt((BLOCKS - 1) * np.var(near, axis=0)) / LESS).tolist()
        if energy < FRACTION or ratio > MAX_DAMPED:
            continue
        blocked = abs(np.mean(np.exp(s[i] * dt / block * np.arange(block))))  # factor of a block mean on the wave
        amplitude = np.sqrt(2 * variance) * size / blocked
        shape = model.shape[:, i] * size
        phase = np.angle(shape / shape[np.argmax(np.abs(shape))])
        estimates = frequency, ratio, energy, frequency_error, ratio_error
        modes.append(RingdownMode(*estimates, tuple(amplitude.tolist()), tuple(phase.tolist())))
    return sorted(modes, key=lambda mode: -mode.energy)
