"""Modes of a ringdown, with quality of fit and standard errors."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from facts_damping.analysis.modes.confidence import errors, fit_waves
from facts_damping.analysis.modes.oscillation import RESOLUTION
from facts_damping.analysis.modes.poles import METHODS, amplitudes, pencil, within
from facts_damping.errors import check_known

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

RATE = 10.0  # samples/s after averaging: four per period of the fastest mode considered
BAND = (0.1, 2.5)  # Hz, electromechanical modes
ENERGY = 0.01  # of the energy of all modes in the band; weaker modes are negligible
LONGEST = 120.0  # s of ringdown: later samples are no response to the event; the cost grows with the square
SKIP = 1.0  # s after the last event that do not count as ringdown
RAYLEIGH = 0.4  # of the frequency resolution: two closer modes are one
MISFIT = 0.01  # of the energy: if fewer poles leave more than this unexplained, two modes are real, however close
METHOD = "matrix_pencil"  # default method
COVERED = 1.96  # standard errors to each side of an estimate: 95 % of a normal distribution


class RingdownMode(NamedTuple):
    """An oscillation `a exp(sigma t) cos(omega t + phase)`, with sigma and omega common to all signals.

    Frequency omega/(2 pi); damping ratio -sigma / sqrt(sigma^2 + omega^2); energy: sum of squares over all samples of
    all signals. The errors are standard errors (NaN: too few samples); amplitude and phase are those at `Fit.start_s`.
    """

    frequency_hz: float
    damping_ratio: float
    energy: float  # p.u.^2
    frequency_error_hz: float
    damping_ratio_error: float
    amplitude: tuple[float, ...]  # p.u., of each signal
    phase_rad: tuple[float, ...]  # of each signal


class Fit(NamedTuple):
    """Result of a method for a ringdown."""

    modes: list[RingdownMode]  # in the band, the strongest first
    order: int  # number of all poles, including conjugates and those outside of the band
    start_s: float  # s, start of the ringdown, to which amplitudes and phases refer
    snr_db: float  # dB, signals without their straight lines against the residual of all poles


def fit_ringdown(
    time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0, method: str = METHOD
) -> Fit | None:
    """Fit damped waves to the last part of a record: its modes of 0.1 to 2.5 Hz, the strongest first.

    `time_s`: (ticks,), s, evenly spaced; `signals`: (ticks, n), p.u.; `since`: s, the last event; the first second
    after it is left out, as is all that is later than two minutes after that; `method`: one of `poles.METHODS`. None if
    less than 3 s are left, a value is not finite, or nothing oscillates. Raises InputError for an unknown method.
    """
    check_known("method", method, METHODS)
    inside = (time_s >= since + SKIP) & (time_s < since + SKIP + LONGEST)
    x = np.reshape(signals, (len(time_s), -1))[inside]
    if len(x) < 2 or time_s[inside][-1] - time_s[inside][0] < 3.0 or not np.isfinite(x).all():
        return None
    t, step = time_s[inside], float(np.median(np.diff(time_s)))
    x, block = block_means(x, step)
    dt = block * step
    x = without_line(x)
    if np.ptp(x, axis=0).max() < RESOLUTION:
        return None
    # BLAS would split small matrices between threads, which on a busy machine wait for each other far longer than
    # they work.
    with threadpool_limits(1):
        z, strong = _choose(x, dt, method)
        return _describe(x, dt, block, z, strong, float(t[0]))


def ringdown_modes(time_s: NDArray[np.float64], signals: NDArray[np.float64], since: float = 0.0) -> list[RingdownMode]:
    """Modes by the matrix pencil, as in `fit_ringdown`; empty without a fit."""
    fit = fit_ringdown(time_s, signals, since)
    return [] if fit is None else fit.modes


def interval(value: float, error: float) -> tuple[float, float]:
    """95 % interval of an estimate with the given standard error."""
    return value - COVERED * error, value + COVERED * error


def _choose(x: NDArray[np.float64], dt: float, method: str) -> tuple[NDArray[np.complex128], dict[complex, float]]:
    """All poles of the method, with the order it needs, and those that are significant modes: pole, energy."""
    right, order = pencil(x)
    z = METHODS[method](x, right, order)
    modes, _ = _strong(x, dt, z)
    while order > 2 and _crowded(modes, dt, len(x) * dt):
        order -= 2
        fewer_z = METHODS[method](x, right, order)
        fewer, rest = _strong(x, dt, fewer_z)
        if rest > MISFIT:
            break  # two close modes are real
        z, modes = fewer_z, fewer
    return within(z, len(x)), modes


def _strong(x: NDArray[np.float64], dt: float, z: NDArray[np.complex128]) -> tuple[dict[complex, float], float]:
    """Significant poles in the band, the strongest first, with energies; the fraction of energy that no pole explains.

    Energies are from a fit of all poles to the signals (samples, n).
    """
    z = within(z, len(x))
    powers, a = amplitudes(z, x)
    # A pole and its conjugate form a wave of twice the amplitude, whose mean square is half the squared amplitude.
    energies = 2 * np.sum(np.abs(a) ** 2, axis=1)
    rest = float(np.sum(np.abs(x - powers @ a) ** 2) / np.sum(x**2))
    omega = np.log(z).imag / dt
    inside = (2 * np.pi * BAND[0] <= omega) & (omega <= 2 * np.pi * BAND[1])
    floor = ENERGY * energies[inside].sum()
    modes = {complex(z[i]): float(energies[i]) for i in np.flatnonzero(inside) if energies[i] >= floor}
    return dict(sorted(modes.items(), key=lambda item: item[1], reverse=True)), rest


def _crowded(poles: Iterable[complex], dt: float, duration: float) -> bool:
    """Whether two modes are closer than a fraction of the resolution 1/T: one real mode, split in two.

    An oscillation whose frequency or damping changes with its amplitude is not exponential: a high order describes it
    by two modes that nearly cancel.
    """
    frequencies = sorted(float(np.log(z).imag / dt / (2 * np.pi)) for z in poles)
    return bool(np.any(np.diff(frequencies) < RAYLEIGH / duration))


def _describe(
    x: NDArray[np.float64], dt: float, block: int, z: NDArray[np.complex128], strong: dict[complex, float], start: float
) -> Fit:
    """The fit of all poles; its modes are the significant ones."""
    waves = fit_waves(z, x, dt)
    frequency_errors, ratio_errors = errors(waves)
    upper = z[z.imag >= 0].tolist()
    modes = []
    for pole, energy in strong.items():
        i = upper.index(pole)
        s = np.log(pole) / dt
        # A sample is the mean of a block; this removes the block's factor on exp(s t), so amplitudes are at the start.
        a = waves.amplitude[i] / np.mean(np.exp(s * dt / block * np.arange(block)))
        estimates = *figures(s), energy, float(frequency_errors[i]), float(ratio_errors[i])
        modes.append(RingdownMode(*estimates, tuple(np.abs(a).tolist()), tuple(np.angle(a).tolist())))
    noise = max(float(np.sum(waves.residual**2)), np.finfo(float).tiny)
    return Fit(modes, len(z), start, float(10 * np.log10(np.sum(x**2) / noise)))


def figures(s: complex) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio of a pole (1/s)."""
    return float(s.imag / (2 * np.pi)), float(-s.real / abs(s))


def block_means(x: NDArray[np.float64], dt: float) -> tuple[NDArray[np.float64], int]:
    """Means of blocks of samples, at about 10 samples/s, and the number of samples per block.

    Exponentials stay exact, with pole z^q for blocks of q samples; components above the band are attenuated.
    """
    q = max(1, int(1 / (RATE * dt) + 1e-6))
    blocks = len(x) // q
    return x[: blocks * q].reshape(blocks, q, x.shape[1]).mean(axis=1), q


def without_line(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Signals without their straight lines: offset and drift would dominate the singular values.

    The poles of the modes do not change; removing a line only adds a double pole at z = 1.
    """
    t = np.linspace(-1, 1, len(x))
    line = np.column_stack([np.ones_like(t), t])
    return np.asarray(x - line @ np.linalg.lstsq(line, x, rcond=None)[0])
