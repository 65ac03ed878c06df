"""Modes of an oscillation that rings down, by the matrix pencil.

Source: Y. Hua, T. K. Sarkar, Matrix pencil method for estimating parameters of exponentially
damped/undamped sinusoids in noise, IEEE Trans. ASSP 38 (1990) 814-824; several signals at once share
their poles, as in Crow and Singh, IEEE Trans. Power Systems 20 (2005) 501-502.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

RATE = 10.0  # samples/s that the signals are brought to: four a period of the fastest mode in sight
BAND = (0.1, 2.5)  # Hz, electromechanical modes
ENERGY = 0.01  # of the energy of all modes in the band: a weaker mode does not matter
SKIP = 1.0  # s after the last event: a disturbance's first second is no ringdown
RESOLUTION = 1e-9  # p.u.: smaller oscillations are rounding
CLEAN = 1e-11  # of the largest singular value: below it there is rounding only
NOISE = 4.0  # times the median singular value: below it there is noise only
OVERFLOW = 1e100  # a pole that grows or shrinks so much over the samples is no mode
RAYLEIGH = 0.4  # of the resolution in frequency: two modes closer than that are one
MISFIT = 0.01  # of the energy: with fewer poles than leave so much unexplained there are two modes, however close
MAX_ORDER = 24  # poles, also the useless ones


class Mode(NamedTuple):
    """An oscillation `a exp(sigma t) cos(omega t)`: frequency omega/(2 pi), damping ratio, energy (p.u.^2).

    damping ratio = -sigma / sqrt(sigma^2 + omega^2); the energy is the sum of squares over all samples.
    """

    frequency_hz: float
    damping_ratio: float
    energy: float


def ringdown_modes(time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0) -> list[Mode]:
    """Modes of 0.1 to 2.5 Hz in the last part of a record, the strongest first.

    `time_s`: (ticks,), s, evenly spaced; `signals`: (ticks, n), p.u.; `since`: s, the last event. Empty if
    less than 3 s are left, or nothing swings.
    """
    kept = time_s >= since + SKIP
    x = np.reshape(signals, (len(time_s), -1))[kept]
    if len(x) < 2 or time_s[kept][-1] - time_s[kept][0] < 3.0 or not np.isfinite(x).all():
        return []
    x, dt = _decimate(x, float(np.median(np.diff(time_s))))
    x = _without_line(x)
    if np.ptp(x, axis=0).max() < RESOLUTION:
        return []
    right, order = pencil(x)
    found, _ = _modes(x, dt, pencil_poles(right, order))
    while order > 2 and _crowded(found, len(x) * dt):
        order -= 2
        fewer, rest = _modes(x, dt, pencil_poles(right, order))
        if rest > MISFIT:
            break  # there are two so close
        found = fewer
    return found


def pencil(signals: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Right singular vectors (rows) of the signals' Hankel matrices, and how many stand out of the noise.

    `signals`: (samples, n). The Hankel matrices of the signals stand below each other, for they share
    their poles.
    """
    length = len(signals) // 3
    hankel = np.concatenate([np.lib.stride_tricks.sliding_window_view(x, length + 1) for x in signals.T])
    # By way of the triangular factor, which has the same values and vectors: BLAS splits the large matrix
    # between threads, and on a busy machine they wait for each other a hundred times longer than they work.
    _, singular, right = np.linalg.svd(np.linalg.qr(hankel, mode="r"), full_matrices=False)
    floor = max(CLEAN * singular[0], NOISE * float(np.median(singular)))
    return right, min(int(np.sum(singular > floor)), MAX_ORDER, length - 1)


def pencil_poles(right: NDArray[np.float64], order: int) -> NDArray[np.complex128]:
    """Poles z of `x_k = sum_i a_i z_i^k`, i = 1..order: eigenvalues of `pinv(V[:-1]) V[1:]`.

    `right`: right singular vectors (rows) as from `pencil`; V holds the first `order` of them as columns.
    """
    V = right[:order].T
    return np.asarray(np.linalg.eigvals(np.linalg.lstsq(V[:-1], V[1:], rcond=None)[0]), np.complex128)


def _strong(modes: list[Mode]) -> list[Mode]:
    """Modes that matter, the strongest first."""
    total = sum(mode.energy for mode in modes)
    strong = [mode for mode in modes if mode.energy >= ENERGY * total]
    return sorted(strong, key=lambda mode: mode.energy, reverse=True)


def _crowded(modes: list[Mode], duration: float) -> bool:
    """Whether two modes are closer than a fraction of the resolution 1/T: one of nature's, split in two.

    An oscillation whose frequency or damping changes with its amplitude is no exponential: a high order
    describes it by two that nearly cancel.
    """
    frequencies = sorted(mode.frequency_hz for mode in modes)
    return bool(np.any(np.diff(frequencies) < RAYLEIGH / duration))


def _modes(x: NDArray[np.float64], dt: float, z: NDArray[np.complex128]) -> tuple[list[Mode], float]:
    """Modes that matter within the band, the strongest first, and the share of the energy that no pole explains.

    Energies are from a fit of all poles to the signals (samples, n).
    """
    growth = np.abs(z) ** len(x)
    z = z[(growth < OVERFLOW) & (growth > 1 / OVERFLOW)]
    powers = z[np.newaxis, :] ** np.arange(len(x))[:, np.newaxis]
    powers /= np.linalg.norm(powers, axis=0)  # a pole that grows fast would hide the others from the fit
    amplitudes = np.linalg.lstsq(powers, x, rcond=None)[0]
    # A pole and its conjugate make a wave of twice the amplitude, whose square is half that on the average.
    energies = 2 * np.sum(np.abs(amplitudes) ** 2, axis=1)
    rest = float(np.sum(np.abs(x - powers @ amplitudes) ** 2) / np.sum(x**2))
    s = np.log(z) / dt
    found = [
        Mode(float(one.imag / (2 * np.pi)), float(-one.real / abs(one)), float(energy))
        for one, energy in zip(s, energies, strict=True)
        if 2 * np.pi * BAND[0] <= one.imag <= 2 * np.pi * BAND[1]
    ]
    return _strong(found), rest


def _decimate(x: NDArray[np.float64], dt: float) -> tuple[NDArray[np.float64], float]:
    """Means of blocks of samples, at about 10 samples/s, and their spacing.

    Any exponential stays an exact one, with pole z^q for blocks of q, and what lies above the band fades.
    """
    q = max(1, int(1 / (RATE * dt) + 1e-6))
    blocks = len(x) // q
    return x[: blocks * q].reshape(blocks, q, -1).mean(axis=1), q * dt


def _without_line(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signals less their straight lines: offset and drift would drown the modes in the singular values.

    Whatever line is taken off, the poles of the modes stay; it only adds a double pole at z = 1.
    """
    t = np.linspace(-1, 1, len(x))
    line = np.column_stack([np.ones_like(t), t])
    return np.asarray(x - line @ np.linalg.lstsq(line, x, rcond=None)[0])
