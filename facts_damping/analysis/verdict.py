"""Decides whether an oscillation decays, grows or persists: growth rate of its envelope with an interval.

The envelope of a signal is `a = sqrt(2 sum w (x - line)^2 / sum w)` over windows of 4 s with Hann weights w, each with
its straight line removed. For a wave `A exp(sigma t) cos(omega t)` its logarithm is a line of slope sigma, except for
ripples due to the phase; the line is fitted by least squares. The residuals are correlated, because windows overlap and
chatter wanders. So Student's interval counts one point per correlation time: the integral of the residuals'
autocorrelation times 1.5, since a fit shortens it; at least half a window.

If one exponential does not fit, or the record is short, and the oscillation at the end is not negligible:

- if a few damped waves with common poles explain nearly all (`ringdown`), such as modes that beat or a growing mode
  behind a decaying one, the worst pole that matters at the end decides, with its interval. If poles are closer than
  1/T, the envelope must give the same verdict, else it is undecided;
- otherwise a piecewise-linear fit is used if it is far better, and the part before the last bend is dropped,
  repeatedly: an oscillation that decays to a limit cycle, or grows until a limit stops it.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.modes.confidence import student_quantile
from facts_damping.analysis.modes.oscillation import BAND, RESOLUTION, WINDOW, envelope
from facts_damping.analysis.modes.ringdown import COVERED, SKIP, block_means, fit_ringdown

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.analysis.modes.ringdown import Fit

DAMPED, GROWING, LIMIT_CYCLE, UNDECIDED, LOST = "damped", "growing", "limit cycle", "undecided", "lost synchronism"
FORCED = "forced oscillation"  # of a run (`judging`), in place of those of ORDER but damped
ORDER = (GROWING, LIMIT_CYCLE, UNDECIDED, DAMPED)  # worst first: the worst verdict of any signal is the run's
HANN = 4.0  # s, window length: one period at 0.25 Hz, the slowest mode considered
HOP = 0.5  # s, between windows
FEWEST = 8  # samples per window, at least
UPPER = 0.975  # quantile for the upper end of a 95 % interval
RIPPLE = 0.05  # relative change of an amplitude from end to end that phases alone can cause; less is no growth
STRAIGHT = 0.01  # root mean square of the logarithm about its line; below, a single exponential fits
CLEAR_DB = 40.0  # signal-to-residual ratio of damped waves; above, the signal is a sum of such waves
LAST, FRACTION = 5.0, 0.25  # s, and fraction of the fitted part, that must follow a bend
BETTER = (0.6, 0.9)  # fractions of the line's residual that one bend, or two, must explain
DEPTH = 0.2  # least change of the logarithm by a bend
WIDER = 1.5  # factor on the correlation time of the residuals, which a fit shortens
FREE = 0.9  # degrees of freedom, at least
STEADY, WIDEST = 0.7, 2.0  # of the logarithm, factors of 2 and 7: see `judge`
DRIFTS = "it drifts: no swing grows"
SLOW = 3  # spectral lines, of up to two periods in the length: a real eigenvalue, not a swing
TONE = 0.3  # least fraction of the energy in three neighbouring spectral lines; less is noise, not an oscillation


class Growth(NamedTuple):
    """Growth rate of an amplitude with its 95 % interval, 1/s, and the signal's name."""

    value: float
    low: float
    high: float
    signal: str


class Judgement(NamedTuple):
    """Verdict on an oscillation, and the reason; growth and amplitude are of the deciding signal."""

    verdict: str  # one of ORDER
    because: str
    growth: Growth | None  # None: no oscillation, or too short
    start_s: float  # s, start of the part judged
    amplitude_pu: float  # median over that part


class _Part(NamedTuple):
    """Data of one signal."""

    name: str
    points: NDArray[np.float64]  # s, centres of the windows
    sizes: NDArray[np.float64]  # p.u., envelope at the points
    samples: NDArray[np.float64]  # p.u., signal without the first second
    dt: float  # s
    floor: float  # p.u.; smaller amplitudes are negligible


def judge(
    time_s: NDArray[np.float64],
    signals: NDArray[np.float64],
    since: float = 0.0,
    names: Sequence[str] = (),
    fitted: Callable[[], Fit | None] | None = None,
) -> Judgement:
    """Judge the oscillation of signals (ticks, n), p.u., after `since` (s; the last event), less its first second.

    A signal is `damped` if the remainder is below 5 % of the largest amplitude of any signal, or if the whole interval
    of its growth is below zero. It is `growing` if the interval is above zero. It is a `limit cycle` if the interval
    contains zero and the amplitude is steady: within a factor of 2 at either end of the interval; or the envelope stays
    within such a factor and the interval allows at most a factor of 7. Otherwise it is `undecided`, as is noise without
    an oscillation. `fitted`: returns the waves that `fit_ringdown` finds in the signals, if already available.
    """
    inside = time_s >= min(since, time_s[-1])
    t, x = time_s[inside], np.reshape(signals, (len(time_s), -1))[inside]
    begin = float(t[0])
    if not np.isfinite(x).all():
        return Judgement(UNDECIDED, "a value is not finite", None, begin, 0.0)
    if np.ptp(x, axis=0).max() < RESOLUTION:
        return Judgement(DAMPED, "there is no oscillation", None, begin, 0.0)
    dt, rest = float(np.median(np.diff(t))), x[t >= begin + SKIP]
    points, sizes = envelopes(rest, dt)
    first = envelope(t, x, begin, min(begin + WINDOW, t[-1]))
    if len(points) < 2:
        because = _too_short(min(begin + SKIP, float(t[-1])), float(t[-1]))
        return Judgement(UNDECIDED, because, None, begin, float(first.max()))
    floor = max(BAND * float(max(first.max(), sizes.max())), RESOLUTION)
    waves = cache(fitted or (lambda: fit_ringdown(time_s, signals, since)))
    parts = [
        _Part(name, points + begin + SKIP, sizes[:, i], rest[:, i], dt, floor)
        for i, name in enumerate(names or map(str, range(x.shape[1])))
    ]
    judged = [_signal(part, i, waves) for i, part in enumerate(parts)]
    return min(judged, key=lambda j: (ORDER.index(j.verdict), -j.growth.high if j.growth else np.inf))


def envelopes(x: NDArray[np.float64], dt: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres of the windows, s from the first sample, and the envelope of each signal, (windows, n).

    `x`: (samples, n), `dt` s apart. Empty if a window has too few samples or is longer than the signal.
    """
    samples, block = block_means(x, dt)
    step = block * dt
    width, hop = round(HANN / step), max(1, round(HOP / step))
    if width < FEWEST or len(samples) < width:
        return np.zeros(0), np.zeros((0, x.shape[1]))
    root = np.sin(np.pi * (np.arange(width) + 0.5) / width)  # of the Hann weights
    line = np.linalg.qr(np.column_stack([root, root * np.linspace(-1, 1, width)]))[0]
    windows = np.lib.stride_tricks.sliding_window_view(samples, width, axis=0)[::hop]
    parts = (windows - windows.mean(axis=2, keepdims=True)) * root
    parts -= (parts @ line) @ line.T
    middles = np.asarray((np.arange(len(windows)) * hop + width / 2) * step, np.float64)
    return middles, np.asarray(np.sqrt(2 * np.sum(parts**2, axis=2) / np.sum(root**2)), np.float64)


def _signal(part: _Part, i: int, waves: Callable[[], Fit | None]) -> Judgement:
    points, sizes = part.points, part.sizes
    if sizes[points >= points[-1] - LAST + HANN / 2].max() < part.floor:
        above = np.flatnonzero(sizes >= part.floor / 2)
        end = 2 + int(above[-1] if len(above) else -1)  # growth until the amplitude became negligible
        because, growth = "what remains is below 5 % of the largest amplitude", _growth(part, 0, end, 2 * FREE)
        return Judgement(DAMPED, because, growth, float(points[0]) - HANN / 2, float(np.median(sizes)))
    logs = np.log(np.maximum(sizes, RESOLUTION))
    whole = _growth(part, 0, len(points))
    if whole is not None and float(np.sqrt(np.mean(_straight(points, logs)[1] ** 2))) <= STRAIGHT:
        return _decide(part, whole, 0)
    fit = waves()
    clear = _of_waves(part, i, fit) if fit is not None and fit.snr_db >= CLEAR_DB else None
    by_waves = None if clear is None else _decide(part, clear, 0)
    if by_waves is not None and not _close(fit, float(points[-1] - points[0]) + HANN):
        return by_waves
    first = _last_part(points, logs)
    judgement = _decide(part, _growth(part, first, len(points)), first)
    if by_waves is None or by_waves.verdict == judgement.verdict:
        return judgement
    because = "its modes are too close to separate in this time: beats, or a mode that depends on amplitude"
    return judgement._replace(verdict=UNDECIDED, because=because)


def _decide(part: _Part, growth: Growth | None, first: int) -> Judgement:
    """Judgement from a growth rate over the windows from `first` on."""
    start = float(part.points[first]) - HANN / 2
    length = float(part.points[-1] - part.points[first]) + HANN
    size = float(np.median(part.sizes[first:]))
    if growth is None:
        return Judgement(UNDECIDED, _too_short(start, start + length), None, start, size)
    if growth.high < 0.0 and growth.value * length < -STEADY:
        return Judgement(DAMPED, "it decays", growth, start, size)
    rest = part.samples[len(part.samples) - round(length / part.dt) :]
    if _tone(rest, part.dt) < TONE:
        return Judgement(UNDECIDED, "what remains is noise, not an oscillation", growth, start, size)
    if growth.high < 0.0:
        return Judgement(DAMPED, "it decays", growth, start, size)
    if growth.low > 0.0:
        return Judgement(GROWING, DRIFTS if _drifts(rest, part.dt) else "it grows", growth, start, size)
    may = max(-growth.low, growth.high) * length
    seen = max(float(np.ptp(np.log(part.sizes[first:]))), 2 * abs(growth.value) * length)
    if may > STEADY and (seen > STEADY or may > WIDEST):
        return Judgement(UNDECIDED, "it may grow or decay: the interval contains zero and is wide", growth, start, size)
    return Judgement(LIMIT_CYCLE, "it neither grows nor decays", growth, start, size)


def _too_short(begin: float, end: float) -> str:
    """Why there is no growth rate: what is judged, s; a part of it may be left out, such as before a bend."""
    return f"too short: {end - begin:.1f} s of oscillation, from {begin:.1f} to {end:.1f} s; {2 * HANN:g} s are needed"


def _growth(part: _Part, first: int, end: int, minimum: float = FREE) -> Growth | None:
    """Slope of the envelope's logarithm over some windows by least squares; None if they are too few."""
    t, y = part.points[first:end], np.log(np.maximum(part.sizes[first:end], RESOLUTION))
    if len(t) < 3:
        return None
    slope, rest = _straight(t, y)
    squares, hop, length = float(rest @ rest), float(t[1] - t[0]), float(t[-1] - t[0]) + HANN / 2
    free = length / (HANN / 2) - 2
    if free < minimum:
        return None
    memory = HANN / 2
    if squares > 1e-18 * len(t):  # else round-off
        correlation = np.correlate(rest, rest, "full")[len(rest) - 1 :] / squares
        below = np.flatnonzero(correlation <= 0.0)  # not empty, because the residuals sum to 0
        memory = max(memory, WIDER * hop * float(1 + 2 * correlation[1 : below[0]].sum()))
    points = max(length / memory - 2, free / 3)
    error = np.sqrt(squares / len(t) / points / np.mean((t - t.mean()) ** 2))
    half = float(student_quantile(free, UPPER) * error + RIPPLE / length)
    return Growth(slope, slope - half, slope + half, part.name)


def _of_waves(part: _Part, i: int, fit: Fit) -> Growth | None:
    """Growth of the worst damped wave that is not negligible in signal i at its end; None if there is none."""
    length = float(part.points[-1]) + HANN / 2 - fit.start_s
    growths = []
    for mode in fit.modes:
        natural = 2 * np.pi * mode.frequency_hz / np.sqrt(1 - mode.damping_ratio**2)
        sigma = float(-mode.damping_ratio * natural)
        half = float(COVERED * natural * np.nan_to_num(mode.damping_ratio_error) + RIPPLE / length)
        if mode.amplitude[i] * np.exp(sigma * length) >= part.floor:
            growths.append(Growth(sigma, sigma - half, sigma + half, part.name))
    return max(growths, key=lambda growth: growth.high, default=None)


def _close(fit: Fit | None, length: float) -> bool:
    """Whether two waves are closer than 1/T: two modes, or one non-exponential mode that was split in two."""
    frequencies = sorted(mode.frequency_hz for mode in fit.modes) if fit is not None else []
    return bool(np.any(np.diff(frequencies) < 1 / length))


def _last_part(points: NDArray[np.float64], logs: NDArray[np.float64]) -> int:
    """First window after the last bend of the envelope's logarithm."""
    first = 0
    while True:
        t, y = points[first:], logs[first:]
        minimum = max(LAST, FRACTION * float(t[-1] - t[0])) - HANN / 2
        bends = np.flatnonzero((t >= t[0] + 2 * HOP) & (t <= t[-1] - minimum))
        if not len(bends):
            return first
        line = np.linalg.qr(np.column_stack([np.ones_like(t), t - t.mean()]))[0]
        hinges = np.maximum(t - t[bends, np.newaxis], 0.0)
        hinges -= (hinges @ line) @ line.T
        bend = _bend(hinges, y - line @ (line.T @ y))
        if bend is None:
            return first
        # Windows around a bend contain both sides.
        first += min(int(bends[bend] + HANN / 2 / HOP), int(bends[-1]))


def _bend(hinges: NDArray[np.float64], rest: NDArray[np.float64]) -> int | None:
    """Index of the hinge that best explains a line's residual, of the later if two are needed; None if not enough."""
    squares, explained, bends = float(rest @ rest), 0.0, []
    for enough in BETTER:
        dots, norms = hinges @ rest, np.maximum(np.sum(hinges**2, axis=1), np.finfo(float).tiny)
        k = int(np.argmax(dots**2 / norms))
        hinge = hinges[k]
        explained += float(dots[k] ** 2 / norms[k])
        if abs(dots[k]) / norms[k] * np.ptp(hinge) < DEPTH:
            return None
        bends.append(k)
        if explained >= enough * squares:
            return max(bends)
        rest = rest - dots[k] / norms[k] * hinge
        hinges = hinges - np.outer(hinges @ hinge / norms[k], hinge)
        hinges[np.sum(hinges**2, axis=1) < 1e-6 * norms] = 0.0  # nearly the same as the first
    return None


def _straight(t: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    """Slope of the least-squares line, and the residual."""
    u = t - t.mean()
    slope = float(u @ y / (u @ u))
    return slope, np.asarray(y - y.mean() - slope * u)


def _spectrum(x: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Fractions of a signal's energy, without its line, by spectral line."""
    samples = block_means(x[:, np.newaxis], dt)[0][:, 0]
    rest = _straight(np.arange(len(samples), dtype=float), samples)[1]
    power = np.abs(np.fft.rfft(rest * np.hanning(len(rest)))) ** 2
    return np.asarray(power / power.sum())


def _tone(x: NDArray[np.float64], dt: float) -> float:
    """Fraction of a signal's energy in the three strongest neighbouring spectral lines."""
    return float(np.convolve(_spectrum(x, dt), np.ones(3)).max())


def _drifts(x: NDArray[np.float64], dt: float) -> bool:
    """Whether most of a signal's energy is slower than two periods in its length."""
    return bool(_spectrum(x, dt)[:SLOW].sum() > 0.5)
