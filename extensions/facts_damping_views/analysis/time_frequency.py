"""The smoothed pseudo Wigner-Ville distribution (SPWVD) of a signal, in Hz and in physical units.

For an analytic signal z at fs samples/s, a window h over the lag tau = 2 m / fs and a window g over time:

    W(n, f) = 2 / fs  sum_m h(m) exp(-j 4 pi f m / fs)  sum_l g(l) z(n + l + m) z*(n + l - m),   0 <= f < fs / 2

with z = 0 outside the record, h(0) = 1, sum g = 1. Its unit is (unit of z)^2/Hz. Without g (one sample) it is the
pseudo Wigner-Ville distribution, without h (all lags) too the Wigner-Ville distribution. With F frequencies df =
fs / (2 F) apart,

    sum_k W(n, f_k) df = sum_l g(l) |z(n + l)|^2        without g: |z(n)|^2
    sum_n W(n, f) / fs = int H(f - v) |Z(v)|^2 dv       without h: |Z(f)|^2

where Z(f) = sum_n z(n) exp(-j 2 pi f n / fs) / fs and H is the Fourier transform of h over the lag. A tone of amplitude
A has |z|^2 = A^2.

Source: (4.110); discrete time: T. Claasen, W. Mecklenbrauker, The Wigner distribution, part II, Philips J. Res. 35
(1980) 276-300; smoothing and cross terms: F. Hlawatsch, G. Boudreaux-Bartels, Linear and quadratic time-frequency
signal representations, IEEE Signal Processing Magazine 9 (1992) 21-67.
"""

from __future__ import annotations

from math import ceil, inf
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import fft, signal

from facts_damping.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

BAND = (0.1, 2.5)  # Hz, electromechanical modes
LAG, TIME = 10.0, 4.0  # s, lengths of the windows over lag and time
OVERSAMPLING = 4  # samples per period of the band's upper end, at least
RIPPLE = 80.0  # dB, attenuation of the filter before decimation above half the new rate
ORDER = 2  # of the high-pass, applied forwards and backwards
BINS = 512  # frequencies, at least
COLUMNS = 4000  # times, at most, if the window over time is long enough to skip none
OVERLAP = 4  # times within the length of that window, at least
BLOCK = 100_000  # products of lags held at once, if the windows allow: 1.6 MB, about one cache
LARGEST_WINDOWS = 2_000_000  # products within both windows
LARGEST = 100_000_000  # values of a distribution: 800 MB
FEWEST = 16  # samples


class Distribution(NamedTuple):
    """W at times (times,), s, and evenly spaced frequencies (bins,), Hz: values (times, bins), (unit of x)^2/Hz."""

    time_s: NDArray[np.float64]
    frequency_hz: NDArray[np.float64]
    values: NDArray[np.float64]

    @property
    def time_marginal(self) -> NDArray[np.float64]:
        """Integral over frequency, (times,): the power |z|^2, smoothed by g, in (unit of x)^2."""
        return np.asarray(self.values.sum(axis=1) * self.frequency_hz[1])

    @property
    def frequency_marginal(self) -> NDArray[np.float64]:
        """Integral over time, (bins,): the energy spectrum |Z|^2, smoothed by H, in (unit of x)^2 s/Hz."""
        step = self.time_s[1] - self.time_s[0] if len(self.time_s) > 1 else 0.0
        return np.asarray(self.values.sum(axis=0) * step)


class Analysed(NamedTuple):
    """A signal's part within a band, and its distribution.

    `time_s`, `x`: (samples,), s and the signal's unit; `z`: (samples,), analytic; `distribution`: its time marginal is
    |z|^2 smoothed; `filled`: number of missing samples that were filled.
    """

    time_s: NDArray[np.float64]
    x: NDArray[np.float64]
    z: NDArray[np.complex128]
    distribution: Distribution
    filled: int


def spwvd(
    z: NDArray[np.complex128],
    rate: float,
    lag_window: NDArray[np.float64] | None = None,
    time_window: NDArray[np.float64] | None = None,
    hop: int = 1,
    bins: int | None = None,
) -> Distribution:
    """Smoothed pseudo Wigner-Ville distribution of an analytic signal, equal to the definition above.

    Args:
        z: (samples,), analytic; of a real signal negative frequencies would fold into 0 to fs / 2
        rate: fs, samples/s
        lag_window: h(-M) .. h(M), even, scaled here to h(0) = 1; none: 1 over all lags
        time_window: g(-L) .. g(L), scaled here to the sum 1; none: a single sample
        hop: samples from one time to the next, the first at sample 0
        bins: F, frequencies in 0 to fs / 2, at least 2 M + 1; none: the next fast length

    Time counts from 0. It takes (samples / hop) bins floats, and up to 200 MB beside with long windows. Raises
    InputError for windows that have no middle or are too long, too few bins, or a result of more than 800 MB.
    """
    h = np.ones(2 * ((len(z) - 1) // 2) + 1) if lag_window is None else np.asarray(lag_window, float)
    g = np.ones(1) if time_window is None else np.asarray(time_window, float)
    _check_windows(h, g)
    M, L = len(h) // 2, len(g) // 2
    F = fft.next_fast_len(2 * M + 1, real=True) if bins is None else bins
    times = ceil(len(z) / hop)
    if F < 2 * M + 1:
        raise InputError(f"bins: {F} given; allowed: at least the {2 * M + 1} of the lag window")
    if times * F > LARGEST:
        raise InputError(
            f"{times} times and {F} frequencies given; allowed: {LARGEST} values: "
            "a shorter record, a shorter lag window, or a larger hop"
        )
    if (M + 1) * (2 * L + 1) > LARGEST_WINDOWS:
        raise InputError(f"windows of {2 * M + 1} lags and {2 * L + 1} samples given; allowed: one of them shorter")
    h, g = h[M:] / h[M], g[::-1, np.newaxis] / g.sum()
    padded = np.pad(z, M + L)
    values = np.empty((times, F))
    rows = max(1, max(BLOCK // (M + 1) - 2 * L, 2 * L) // hop)
    for first in range(0, times, rows):
        count = min(rows, times - first)
        span = (count - 1) * hop + 2 * L + 1
        lags = np.lib.stride_tricks.sliding_window_view(padded[first * hop :][: span + 2 * M], 2 * M + 1)
        products = lags[:, M:] * lags[:, M::-1].conj()  # m = 0 .. M; those of -m are their conjugates
        if L:
            products = signal.oaconvolve(products, g, mode="valid", axes=0)
        values[first : first + count] = fft.hfft(products[::hop] * h, F, axis=1)
    values *= 2 / rate
    return Distribution(np.arange(0, len(z), hop) / rate, np.linspace(0, rate / 2, F, endpoint=False), values)


def analyse(
    time_s: NDArray[np.float64],
    x: NDArray[np.float64],
    lag: float = LAG,
    time: float = TIME,
    band: tuple[float, float] = BAND,
) -> Analysed:
    """SPWVD of a recorded signal within a band, with Hann windows.

    Args:
        time_s: (ticks,), s, on an even grid of which some may be missing
        x: (ticks,), any unit; NaN: missing, to be filled by a straight line
        lag: s, length of the lag window, from -lag/2 to lag/2; inf: all lags. It tells frequencies 2/lag apart
        time: s, length of the time window; 0: none. Cross terms of tones 2/time and more apart fall below 1/37
        band: Hz, what is analysed. Below, the trend is taken off by a second-order high-pass without delay, 0: the
            mean; above, the signal is decimated to the lowest rate of at least four times the upper end, or not

    Raises InputError if less than 16 samples are known, or the band does not fit the rate of the record.
    """
    even_s, even, filled = _evenly(time_s, x)
    rate = (len(even_s) - 1) / (even_s[-1] - even_s[0])
    _check_asked(lag, time, band, rate)
    decimated, q = _decimated(even - even.mean(), rate, band[1])
    rate /= q
    if len(decimated) < FEWEST:
        raise InputError(f"{len(decimated) / rate:.3g} s given; allowed: at least {FEWEST / rate:.3g} s for this band")
    detrended = _without_trend(decimated, rate, band[0])
    z = analytic(detrended)
    maximum = (len(z) - 1) // 2
    h = None if lag == inf else _hann(lag / 2, rate, maximum)
    g = _hann(time, rate, len(z))
    hop = max(1, min(len(z) // COLUMNS, len(g) // OVERLAP))
    bins = max(BINS, 2 * maximum + 1 if h is None else len(h))
    distribution = spwvd(z, rate, h, g, hop, fft.next_fast_len(bins, real=True))
    at = even_s[0] + np.arange(len(z)) / rate
    return Analysed(at, detrended, z, distribution._replace(time_s=at[::hop]), filled)


def analytic(x: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Analytic signal x + j H(x) of (samples,), H the Hilbert transform of a signal that is zero outside the record.

    So the end does not reach into the beginning, as it does in a discrete Fourier transform of the record alone.
    """
    return np.asarray(signal.hilbert(x, fft.next_fast_len(2 * len(x)))[: len(x)], np.complex128)


def _check_windows(h: NDArray[np.float64], g: NDArray[np.float64]) -> None:
    """Raise InputError for windows without a middle or with a scale of zero."""
    for name, window in (("lag window", h), ("time window", g)):
        if window.ndim != 1 or len(window) % 2 == 0:
            raise InputError(f"{name}: {window.size} samples given; allowed: an odd number")
    if h[len(h) // 2] == 0 or g.sum() == 0:
        raise InputError("windows: h(0) or the sum of g is 0; allowed: any other number")
    if not np.allclose(h, h[::-1], rtol=1e-9, atol=0):
        raise InputError("lag window: not even; allowed: h(-m) = h(m)")


def _check_asked(lag: float, time: float, band: tuple[float, float], rate: float) -> None:
    """Raise InputError for windows or bands that do not fit a record of that rate (samples/s)."""
    if not lag > 0:
        raise InputError(f"lag window: {lag:g} s given; allowed: above 0 s, or inf")
    if not 0 <= time < inf:
        raise InputError(f"time window: {time:g} s given; allowed: 0 s and more")
    if not 0 <= band[0] < band[1] <= rate / 2 * (1 + 1e-9):
        raise InputError(f"band: {band[0]:g} to {band[1]:g} Hz given; allowed: rising, within 0 to {rate / 2:g} Hz")


def _hann(length: float, rate: float, maximum: int) -> NDArray[np.float64]:
    """Hann window of that length (s), at most `maximum` samples each side of the middle, without its zero ends."""
    half = max(0, min(maximum, ceil(min(length * rate / 2, maximum + 1) - 1e-9) - 1))
    return np.asarray(np.cos(np.pi * np.arange(-half, half + 1) / max(length * rate, 1.0)) ** 2)


def _evenly(
    time_s: NDArray[np.float64], x: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """A signal on the grid of its most frequent step, from first to last known sample; number of filled samples."""
    known = np.isfinite(x)
    if known.sum() < FEWEST:
        raise InputError(f"{known.sum()} known samples given; allowed: at least {FEWEST}")
    step = float(np.median(np.diff(time_s)))
    t, x = time_s[known], x[known]
    count = round((t[-1] - t[0]) / step) + 1
    grid = np.linspace(t[0], t[-1], count)
    return grid, np.interp(grid, t, x), count - len(t)


def _decimated(x: NDArray[np.float64], rate: float, high: float) -> tuple[NDArray[np.float64], int]:
    """A signal at a rate q times lower, and q; the anti-aliasing filter leaves frequencies up to `high` unchanged."""
    q = max(1, int(rate / (OVERSAMPLING * high) + 1e-9))
    if q == 1:
        return x, q
    edge = rate / 2 / q
    taps, beta = signal.kaiserord(RIPPLE, 2 * (edge - high) / rate)
    low_pass = signal.firwin(taps | 1, (high + edge) / 2, window=("kaiser", beta), fs=rate)
    return np.asarray(signal.resample_poly(x, 1, q, window=low_pass, padtype="reflect")), q


def _without_trend(x: NDArray[np.float64], rate: float, low: float) -> NDArray[np.float64]:
    """A signal without its mean and, unless `low` is 0, without components below `low` (Hz)."""
    if low > 0:
        high_pass = signal.butter(ORDER, low, "highpass", fs=rate, output="sos")
        x = signal.sosfiltfilt(high_pass, x, padtype="even", padlen=min(len(x) - 1, ceil(OVERSAMPLING * rate / low)))
    return np.asarray(x - x.mean())
