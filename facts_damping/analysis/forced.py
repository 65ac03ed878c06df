"""Tells a forced oscillation from a natural one, a mode of the grid, by swings alone.

Damping control removes a mode's oscillation, and not one that is forced from outside of the loop. Both look alike for a
while: a forced one begins like the modes, and a mode of low damping lasts. Three features separate them.

- **A line.** Modes in noise make an autoregressive process, y_k = sum_i phi_i y_k-i + e_k, in which their decay and
  growth are exact as well; a source adds b cos(2 pi f t) + c sin(2 pi f t) to e_k. The F test of b = c = 0 at all
  frequencies, corrected for their number, tells whether there is a line that modes do not make. J. D. Follum, J. W.
  Pierre, R. Martin, Simultaneous estimation of electromechanical modes and forced oscillations, IEEE Trans. Power Syst.
  32 (2017) 3958-3967.
- **A constant amplitude.** At a mode's own frequency a line is the same as an undamped pole. There the pole's growth
  rate decides: its interval leaves out zero, or is narrow around it. A natural oscillation in noise has the memory
  1/(zeta omega): X. Wang, K. Turitsyn, Data-driven diagnostics of mechanism and source of sustained oscillations, ibid.
  31 (2016) 4036-4046. Kurtosis and distribution of the envelope need a record of many such times, the rate of few.
- **Its start.** What a limit contains has grown exponentially; a forced one approaches its size as 1 - exp(sigma t):
  R. Xie, D. Trudnowski, Distinguishing features of natural and forced oscillations, IEEE PES General Meeting 2015.

Harmonics do not count: many sources have none, and limits of a loop make them, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from facts_damping.analysis.modes.oscillation import RESOLUTION
from facts_damping.analysis.modes.ringdown import BAND, COVERED, SKIP, fit_ringdown
from facts_damping.analysis.verdict import RIPPLE, envelopes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.analysis.modes.ringdown import Fit

    Floats = NDArray[np.float64]

FORCED, NATURAL, UNDECIDED, NONE = "forced", "natural", "undecided", "none"
SHORTEST = 8.0  # s
RATE, LAGS = 5.0, 10  # samples/s, and order, of the autoregressive process
LEVEL = 3e-4  # chance of a line where there is none
CLEAR_DB = 25.0  # of a ringdown whose waves may decide
LASTING = 0.3  # of the largest wave at the end; smaller ones do not count
SMALL = 0.15  # of the largest line; smaller ones do not count
ZOOM = 32  # lines of the spectrum where there is one without padding
STEADY = 0.004  # damping ratio that the interval of a constant amplitude may reach to both sides
REST = 0.6  # of a wave; a source that begins from rest has moved less at first, all waves together
CONSTANT = "its amplitude is constant: a source, or a mode without damping"
GROWTH = "it grows"
GROWS = 1.5  # times the interval of a rate that grows: a forced one grows at its start, too
STEPS, STRAIGHT = (0.125, 0.25, 0.5), 1.4  # fractions of the last amplitude, and ratio of the times between them


class Origin(NamedTuple):
    """What an oscillation comes from (FORCED, NATURAL, UNDECIDED; NONE: there is no oscillation), and why."""

    kind: str
    frequency_hz: float
    statistic: float  # F of the line; else the growth rate over half of its 95 % interval
    because: str
    amplitude_pu: float = 0.0  # of the signal in which it is largest, in the last half


def origin(time_s: Floats, signals: Floats, since: float = 0.0) -> Origin:
    """What the oscillation of signals (ticks, n), p.u., after `since` (s; the last event) comes from.

    `time_s`: (ticks,), s, evenly spaced. UNDECIDED: the record is too short for its noise.
    """
    dt = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    x = np.reshape(signals, (len(time_s), -1))[time_s >= since + SKIP]
    if len(x) * dt < SHORTEST or not np.isfinite(x).all() or np.ptp(x, axis=0).max() < RESOLUTION:
        return Origin(NONE, 0.0, 0.0, "too short, or nothing oscillates")
    fit = fit_ringdown(time_s, signals, since)
    with threadpool_limits(1):
        cause = _of_waves(fit, since, len(x) * dt) if fit and fit.modes and fit.snr_db >= CLEAR_DB else _in_noise(x, dt)
    if (cause.kind == FORCED or cause.because == CONSTANT) and _has_grown(x, dt):
        cause = cause._replace(kind=NATURAL, because="it has grown exponentially until something limits it")
    half = x[len(x) // 2 :]
    turn = np.exp(-2j * np.pi * cause.frequency_hz * dt * np.arange(len(half))) * np.hanning(len(half))
    return cause._replace(amplitude_pu=float(np.abs(turn @ (half - half.mean(axis=0))).max() * 4 / len(half)))


def words(forced: Origin, nominal: float | None) -> str:
    """A forced oscillation in words; `nominal`: frequency of the grid, Hz; None: not known."""
    size = f"{1e3 * nominal * forced.amplitude_pu:.3g} mHz" if nominal else f"{forced.amplitude_pu:.3g} p.u."
    return f"{forced.frequency_hz:.2f} Hz, {size}; damping control does not remove it"


def _of_waves(fit: Fit, since: float, length: float) -> Origin:
    """From damped waves that explain the swings: those that matter at the end, `length` s later."""
    poles = np.array([2 * np.pi * mode.frequency_hz * complex(-mode.damping_ratio, 1) for mode in fit.modes])
    waves = np.array([np.multiply(mode.amplitude, np.exp(1j * np.array(mode.phase_rad))) for mode in fit.modes])
    errors = np.nan_to_num([mode.damping_ratio_error for mode in fit.modes], nan=1.0)
    halves = COVERED * poles.imag * errors + RIPPLE / length
    sizes = np.abs(waves).max(axis=1) * np.exp(np.minimum(poles.real * length, 50.0))
    first = np.exp(poles * (since - fit.start_s))[:, np.newaxis] * waves
    origins = []
    for i in np.flatnonzero(sizes >= LASTING * sizes.max()):
        omega = poles[i].imag
        cause = _of_rate(omega / (2 * np.pi), poles[i].real, halves[i])
        motion = np.hypot(first.sum(axis=0).real, (poles @ first).real / omega)
        rest = float(np.linalg.norm(motion) / np.linalg.norm(waves[i]))
        if rest < REST and abs(poles[i].real) < STEADY * omega:  # noise that is left makes intervals too narrow
            cause = cause._replace(kind=FORCED, because="it begins from rest, and its amplitude is constant")
        origins.append(cause)
    return min(origins, key=lambda cause: (FORCED, UNDECIDED, NATURAL).index(cause.kind))


def _of_rate(hertz: float, rate: float, half: float) -> Origin:
    """From a growth rate and half of its interval, 1/s."""
    kind, because = UNDECIDED, "it may be either: the record is too short for its noise"
    if rate < -half or rate > GROWS * half:
        kind, because = NATURAL, GROWTH if rate > 0 else "it decays, by itself or in noise"
    elif abs(rate) + half < STEADY * 2 * np.pi * hertz:
        because = CONSTANT
    return Origin(kind, float(hertz), float(rate / half), because)


def _in_noise(x: Floats, dt: float) -> Origin:
    """From an autoregressive process of each signal: a line in any, else the rate of the strongest oscillation."""
    block = max(1, round(1 / (RATE * dt)))
    y = x[: len(x) // block * block].reshape(-1, block, x.shape[1]).mean(axis=1)
    y, step = (y - y.mean(axis=0))[:, np.ptp(y, axis=0) >= RESOLUTION], block * dt
    power = np.abs(np.fft.rfft(y * np.hanning(len(y))[:, np.newaxis], ZOOM * len(y), axis=0)).T
    lines = np.fft.rfftfreq(ZOOM * len(y), step)
    power[:, (lines < BAND[0]) | (lines > BAND[1])] = 0.0
    strongest, peak = np.unravel_index(int(np.argmax(power)), power.shape)
    # The F of a strong line is narrow, as the past nearly tells it: it is tested at the very peaks.
    peaks = lines[np.argmax(power, axis=1)]
    frequencies = np.sort(np.concatenate([np.arange(*BAND, 0.25 / (len(y) * step)), peaks]))
    tests = [_line(signal, step, frequencies) for signal in y.T]
    near = _nearest(tests[strongest][1], lines[peak])
    values, free = np.array([values for values, _ in tests]), len(y) - 2 * LAGS - 4
    large = np.array([np.interp(frequencies, lines, row) for row in power]) >= SMALL * power.max()
    best = float((values * large).max())
    if near.because != GROWTH and values.size / 4 * (1 + 2 * best / free) ** (-free / 2) < LEVEL:
        hertz = float(frequencies[np.argmax(values * large) % len(frequencies)])
        return Origin(FORCED, hertz, best, "there is a line that no mode makes")
    return near


def _nearest(poles: list[tuple[float, float, float]], hertz: float) -> Origin:
    """From the pole that is nearest to an undamped one of a frequency."""
    return _of_rate(*min(poles, key=lambda pole: abs(pole[0] - hertz) + abs(pole[1]) / (2 * np.pi)))


def _line(y: Floats, step: float, frequencies: Floats) -> tuple[Floats, list[tuple[float, float, float]]]:
    """F of a line at each frequency; poles of the process without it: Hz, growth rate, half of its interval, 1/s."""
    past, now = np.lib.stride_tricks.sliding_window_view(y / y.std(), LAGS)[:-1, ::-1], y[LAGS:] / y.std()
    count, free = len(now), len(now) - LAGS - 4
    q, r = np.linalg.qr(np.column_stack([past, np.ones(count), np.linspace(-1, 1, count)]))
    rest = now - q @ (q.T @ now)
    angles = 2 * np.pi * step * np.outer(np.arange(count), frequencies)
    cos, sin = (wave - q @ (q.T @ wave) for wave in (np.cos(angles), np.sin(angles)))
    a, b, c = (np.sum(left * right, axis=0) for left, right in ((cos, cos), (sin, sin), (cos, sin)))
    u, v, squares = cos.T @ rest, sin.T @ rest, float(rest @ rest)
    gain = (b * u**2 - 2 * c * u * v + a * v**2) / np.maximum(a * b - c**2, 1e-9 * count**2)
    inverse = np.linalg.inv(r)
    covariance = (inverse @ inverse.T)[:LAGS, :LAGS] * squares / free
    polynomial = np.concatenate([[1.0], -(inverse @ (q.T @ now))[:LAGS]])
    poles = []
    for z in np.roots(polynomial):
        s = np.log(z) / step
        slopes = (z ** (LAGS - 2.0 - np.arange(LAGS)) / np.polyval(np.polyder(polynomial), z) / step).real
        half = COVERED * float(np.sqrt(slopes @ covariance @ slopes)) + RIPPLE / (count * step)
        poles.append((float(s.imag / (2 * np.pi)), float(s.real), half))
    return gain / 2 * free / np.maximum(squares - gain, 1e-12 * count), poles


def _has_grown(x: Floats, dt: float) -> bool:
    """Whether the largest envelope takes as long from 1/8 of its last size to 1/4 as from there to 1/2."""
    points, sizes = envelopes(x, dt)
    if len(points) < 2:
        return False
    size = sizes[:, int(np.argmax(sizes[-1]))]
    last = float(np.median(size[len(size) // 2 :]))
    first, second, third = (points[np.argmax(size >= part * last)] for part in STEPS)
    return bool(size[0] < STEPS[0] * last and third - second < STRAIGHT * (second - first))
