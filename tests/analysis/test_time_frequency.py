"""The smoothed pseudo Wigner-Ville distribution against its definition, another program and closed forms."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.errors import InputError
from facts_damping_views.analysis.time_frequency import Distribution, analyse, analytic, spwvd

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Samples = NDArray[np.complex128]
    Window = NDArray[np.float64]

RATE = 10.0
ONE = np.ones(1)
T = np.arange(1200) / 60


def noise(seed: int, samples: int = 41) -> Samples:
    real, imaginary = np.random.default_rng(seed).standard_normal((2, samples))
    return np.asarray(real + 1j * imaginary)


def hann(length: int) -> Window:
    return np.hanning(length + 2)[1:-1]


def tone(frequency: float, samples: int = 400, amplitude: float = 1.0) -> Samples:
    return np.asarray(amplitude * np.exp(2j * np.pi * frequency * np.arange(samples) / RATE))


def lag_sums(z: Samples, g: Window, lags: int) -> Samples:
    """Sum over i of g(i) z(n+i+m) z*(n+i-m), (samples, lags + 1), one term after the other."""
    sums = np.zeros((len(z), lags + 1), complex)
    half = len(g) // 2
    for n in range(len(z)):
        for m in range(lags + 1):
            for i in range(-half, half + 1):
                if n + i - m >= 0 and n + i + m < len(z):
                    sums[n, m] += g[half + i] * z[n + i + m] * np.conj(z[n + i - m])
    return sums


def by_definition(z: Samples, rate: float, h: Window, g: Window, bins: int) -> NDArray[np.complex128]:
    """W(n, f) of the module's first lines, one term after the other."""
    half = len(h) // 2
    sums = lag_sums(z, g / g.sum(), half)
    distribution = np.zeros((len(z), bins), complex)
    for k in range(bins):
        f = k * rate / (2 * bins)
        for m in range(-half, half + 1):
            product = sums[:, m] if m >= 0 else sums[:, -m].conj()
            distribution[:, k] += 2 / rate * h[half + m] * product * np.exp(-4j * np.pi * f * m / rate)
    return distribution


@pytest.mark.parametrize("lag", [1, 7, 11])
@pytest.mark.parametrize("time", [1, 5, 9])
@pytest.mark.parametrize("bins", [11, 12, 20])
def test_definition_term_by_term(lag: int, time: int, bins: int) -> None:
    z, h, g = noise(lag + time, 17), np.hamming(lag) / np.hamming(lag)[lag // 2], np.hamming(time)
    known = by_definition(z, 3.0, h, g, bins)
    assert np.abs(known.imag).max() < 1e-12
    distribution = spwvd(z, 3.0, h, g, bins=bins)
    np.testing.assert_allclose(distribution.values, known.real, atol=1e-12)
    np.testing.assert_allclose(distribution.frequency_hz, np.arange(bins) * 1.5 / bins, rtol=1e-15)
    np.testing.assert_allclose(distribution.time_s, np.arange(17) / 3.0, rtol=1e-15)


@pytest.mark.parametrize("hop", [2, 5, 40])
def test_hop_leaves_out_times_and_blocks_leave_no_seam(hop: int, monkeypatch: pytest.MonkeyPatch) -> None:
    z, h, g = noise(1, 100), hann(13), hann(7)
    whole = spwvd(z, RATE, h, g)
    monkeypatch.setattr("facts_damping_views.analysis.time_frequency.BLOCK", 100)
    np.testing.assert_allclose(spwvd(z, RATE, h, g).values, whole.values, atol=1e-13)
    some = spwvd(z, RATE, h, g, hop)
    np.testing.assert_allclose(some.values, whole.values[::hop], atol=1e-13)
    np.testing.assert_array_equal(some.time_s, whole.time_s[::hop])


GOLDEN = np.load(Path(__file__).parents[1] / "data" / "tftb.npz")


def test_without_windows_it_is_the_wigner_ville_distribution_of_tftb() -> None:
    distribution = spwvd(GOLDEN["z"], 1.0, bins=32)
    np.testing.assert_allclose(distribution.values.T, 2 * GOLDEN["wvd"], atol=1e-12)


def test_without_time_window_it_is_the_pseudo_wigner_ville_distribution_of_tftb() -> None:
    distribution = spwvd(GOLDEN["z"], 1.0, GOLDEN["h"], bins=32)
    np.testing.assert_allclose(distribution.values.T, 2 * GOLDEN["pwvd"], atol=1e-12)


def test_tftb_is_off_by_a_lag_and_a_sample_with_both_windows() -> None:
    """Its row m + 1 has the sum of lag m, weighted by h(m + 1) and, at -m - 1, by h(m - 1); column n is of n - 1.

    That is compared away from the ends, where it also scales the time window anew.
    """
    z, h, g = (GOLDEN[name] for name in ("z", "h", "g"))
    half, inner = len(h) // 2, range(10, 22)
    sums = lag_sums(z, g / g.sum(), half)
    shifted = np.zeros((len(inner), 32), complex)
    for i, n in enumerate(inner):
        shifted[i, 0] = sums[n - 1, 0]
        for m in range(half):
            shifted[i, m + 1] = h[half + m + 1] * sums[n - 1, m]
            shifted[i, 32 - m - 1] = h[half - m + 1] * sums[n - 1, m].conj()
    theirs = GOLDEN["spwvd"].T[inner.start : inner.stop]
    np.testing.assert_allclose(np.fft.fft(shifted, axis=1).real, theirs, atol=1e-12)
    ours = spwvd(z, 1.0, h, g, bins=32).values / 2
    for column in (0, -1):
        same = ours[inner.start + column : inner.stop + column]
        assert np.abs(theirs - same).max() > 0.2 * np.abs(same).max()


@given(seed=st.integers(0, 2**32 - 1), lag=st.integers(0, 20), bins=st.integers(41, 60), rate=st.floats(0.1, 1e3))
@settings(deadline=None)
def test_time_marginal_is_the_power(seed: int, lag: int, bins: int, rate: float) -> None:
    z = noise(seed)
    for h in (None, hann(2 * lag + 1)):
        distribution = spwvd(z, rate, h, bins=bins)
        np.testing.assert_allclose(distribution.time_marginal, np.abs(z) ** 2, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), time=st.integers(0, 12))
@settings(deadline=None)
def test_time_marginal_is_the_power_smoothed(seed: int, time: int) -> None:
    z, g = noise(seed), hann(2 * time + 1)
    smoothed = np.convolve(np.abs(z) ** 2, g / g.sum(), mode="same")
    np.testing.assert_allclose(spwvd(z, RATE, hann(15), g).time_marginal, smoothed, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_frequency_marginal_is_the_energy_spectrum(seed: int) -> None:
    """Of any signal |Z(f)|^2 + |Z(f + fs/2)|^2; the second is 0 of an analytic one."""
    z = noise(seed)
    distribution = spwvd(z, RATE, bins=50)
    Z = np.fft.fft(z, 100) / RATE
    np.testing.assert_allclose(distribution.frequency_marginal, np.abs(Z[:50]) ** 2 + np.abs(Z[50:]) ** 2, atol=1e-12)


def test_frequency_marginal_is_smoothed_by_the_lag_window() -> None:
    z, h, F = noise(3), hann(21), 64
    Z2 = np.abs(np.fft.fft(z, 2 * F) / RATE) ** 2
    lags = np.arange(-10, 11)
    H = 2 / RATE * (h * np.exp(-2j * np.pi * np.outer(np.arange(F), lags) / F)).sum(axis=1).real
    folded = (Z2[:F] + Z2[F:]) * RATE / 2 / F
    known = [sum(H[(k - v) % F] * folded[v] for v in range(F)) for k in range(F)]
    np.testing.assert_allclose(spwvd(z, RATE, h, bins=F).frequency_marginal, known, atol=1e-12)


@given(amplitude=st.floats(1e-6, 1e3), k=st.integers(20, 236))
@settings(deadline=None)
def test_tone_integrates_to_its_amplitude_squared_at_its_frequency(amplitude: float, k: int) -> None:
    z = tone(k * RATE / 512, amplitude=amplitude)
    distribution = spwvd(z, RATE, hann(81), hann(21), 7, 256)
    inner = slice(10, -10)
    np.testing.assert_allclose(distribution.time_marginal[inner], amplitude**2, rtol=1e-12)
    assert np.all(distribution.values[inner].argmax(axis=1) == k)


@given(seed=st.integers(0, 2**32 - 1), shift=st.integers(0, 30), k=st.integers(0, 99))
@settings(deadline=None)
def test_shifts_in_time_and_frequency_shift_it(seed: int, shift: int, k: int) -> None:
    z, h, g = noise(seed), hann(25), hann(9)
    long = np.concatenate([np.zeros(20), z, np.zeros(50)])
    plain = spwvd(long, RATE, h, g, bins=100).values
    later = spwvd(np.roll(long, shift), RATE, h, g, bins=100).values
    np.testing.assert_allclose(later[shift:], plain[: len(plain) - shift], atol=1e-12)
    higher = spwvd(long * tone(k * RATE / 200, len(long)), RATE, h, g, bins=100).values
    np.testing.assert_allclose(higher, np.roll(plain, k, axis=1), atol=1e-12)


@given(start=st.floats(0.3, 2.0), end=st.floats(2.2, 4.7), up=st.booleans())
@settings(deadline=None)
def test_ridge_of_a_chirp_lies_within_a_bin(start: float, end: float, up: bool) -> None:
    first, last = (start, end) if up else (end, start)
    t = np.arange(200) / RATE
    rise = (last - first) / t[-1]
    z = np.exp(2j * np.pi * (first + rise * t / 2) * t)
    for h, g in ((None, None), (hann(41), None), (hann(41), hann(15))):
        distribution = spwvd(z, RATE, h, g, bins=400)
        ridge = distribution.frequency_hz[distribution.values.argmax(axis=1)]
        inner = slice(30, -30)
        assert np.abs(ridge - first - rise * t)[inner].max() <= distribution.frequency_hz[1]


def swing(distribution: Distribution, frequency: float) -> float:
    """How far W goes up and down at a frequency, away from the ends."""
    k = int(np.abs(distribution.frequency_hz - frequency).argmin())
    return float(np.ptp(distribution.values[100:-100, k]))


@pytest.mark.parametrize("apart", [0.3, 0.55, 0.8, 1.5])
def test_cross_terms_fall_by_the_response_of_the_time_window(apart: float) -> None:
    """Of two tones halfway between them; Hann's window of 4 s, 0.5 Hz apart and more: below 1/37."""
    low, h, g = 0.5, hann(99), hann(39)
    z = tone(low) + tone(low + apart)
    halfway = low + apart / 2
    plain, smoothed = (spwvd(z, RATE, h, window, bins=800) for window in (None, g))
    response = abs(np.sum(g * np.exp(2j * np.pi * apart * np.arange(-19, 20) / RATE)) / g.sum())
    assert swing(plain, halfway) > 3 * plain.values[200, int(low * 160)] > 0  # stronger than the tones themselves
    assert swing(smoothed, halfway) == pytest.approx(response * swing(plain, halfway), rel=1e-6)
    assert response < 1 / 37 or apart < 0.5


def test_analytic_signal() -> None:
    x = 3 * np.cos(2 * np.pi * 0.7 * T + 0.4)
    z = analytic(x)
    np.testing.assert_allclose(z.real, x, atol=1e-13)
    np.testing.assert_allclose(np.abs(z[240:-240]), 3, rtol=0.02)


@pytest.mark.parametrize("rate", [30, 60, 120])
def test_recorded_tones_in_hz_and_in_their_power(rate: int) -> None:
    """Of 0.63 Hz and 1.15 Hz, on an offset, under a slow drift and a ripple of 12 Hz: power A^2, ridge within a bin."""
    t = np.arange(60 * rate) / rate
    slow = 4.0 - 0.02 * t + 0.1 * np.cos(2 * np.pi * 0.01 * t) + 0.01 * np.cos(2 * np.pi * 12.0 * t)
    x = slow + 3e-3 * np.cos(2 * np.pi * 0.63 * t + 1.0) + 1e-3 * np.cos(2 * np.pi * 1.15 * t)
    analysis = analyse(5.0 + t, x)
    distribution = analysis.distribution
    assert analysis.filled == 0
    assert distribution.time_s[0] == analysis.time_s[0] == 5.0
    assert np.diff(distribution.time_s) == pytest.approx(np.full(len(distribution.time_s) - 1, 0.1))
    inner = slice(100, -100)
    for amplitude, frequency in ((3e-3, 0.63), (1e-3, 1.15)):
        near = np.abs(distribution.frequency_hz - frequency) < 0.25
        ridge = distribution.frequency_hz[near][distribution.values[inner, near].argmax(axis=1)]
        assert ridge == pytest.approx(np.full_like(ridge, frequency), abs=distribution.frequency_hz[1])
        power = distribution.values[inner, near].sum(axis=1) * distribution.frequency_hz[1]
        assert power == pytest.approx(np.full_like(power, amplitude**2), rel=0.05)


def test_spwvd_holds_no_components_outside_its_band() -> None:
    x = 5.0 + np.cos(2 * np.pi * 0.02 * T) + np.cos(2 * np.pi * 6.0 * T)
    assert analyse(T, x).distribution.time_marginal[30:-30].max() < 1e-2
    high = analyse(T, x, 2.0, 1.0, (0.5, 30.0)).distribution
    ridge = high.frequency_hz[high.values.argmax(axis=1)]
    assert ridge[100:-100] == pytest.approx(np.full(len(ridge) - 200, 6.0), abs=high.frequency_hz[1])


def test_missing_samples_are_filled_and_counted() -> None:
    x = np.cos(2 * np.pi * 0.6 * T)
    holes, whole = x.copy(), analyse(T, x)
    holes[[300, 301, 600]] = np.nan
    present = np.delete(np.arange(1200), [700, 701])
    analysis = analyse(T[present], holes[present])
    assert analysis.filled == 5
    np.testing.assert_allclose(analysis.distribution.values, whole.distribution.values, atol=1e-2)
    ends = np.where((T < 1) | (T > 19), np.nan, x)
    assert analyse(T, ends).time_s[0] == pytest.approx(1.0)


def test_windows_of_the_limits() -> None:
    x = np.cos(2 * np.pi * 0.6 * T)
    wvd = analyse(T, x, np.inf, 0.0)
    np.testing.assert_allclose(wvd.distribution.time_marginal, np.abs(wvd.z) ** 2, atol=1e-12)
    np.testing.assert_allclose(wvd.distribution.values, spwvd(wvd.z, RATE, bins=512).values, atol=1e-12)
    pseudo = analyse(T, x, 10.0, 0.0)
    np.testing.assert_allclose(pseudo.distribution.values, spwvd(pseudo.z, RATE, hann(49), ONE, bins=512).values)
    nearly = analyse(T, x, 1e6, 0.0)
    np.testing.assert_allclose(nearly.distribution.values, wvd.distribution.values, atol=1e-6)


def test_hour_has_as_many_times_as_needed() -> None:
    t = np.arange(3600 * 60) / 60
    distribution = analyse(t, np.cos(2 * np.pi * 0.6 * t)).distribution
    assert distribution.time_s[-1] == pytest.approx(3600, abs=1)
    assert distribution.values.size < 3e6
    np.testing.assert_allclose(distribution.time_marginal[10:-10], 1, rtol=2e-3)


Given = dict[str, object]


@pytest.mark.parametrize(
    ("given_", "reason"),
    [
        ({"lag_window": np.ones(4)}, "lag window: 4 samples given; allowed: an odd number"),
        ({"time_window": np.ones((3, 3))}, "time window: 9 samples given; allowed: an odd number"),
        ({"lag_window": np.array([1.0, 1.0, 2.0])}, "lag window: not even; allowed"),
        ({"time_window": np.zeros(3)}, "the sum of g is 0; allowed"),
        ({"lag_window": np.ones(5), "bins": 4}, "bins: 4 given; allowed: at least the 5"),
        ({"time_window": np.ones(10**5 + 1)}, "windows of 41 lags and 100001 samples given; allowed: one of them"),
        ({"bins": 10**9}, "41 times and 1000000000 frequencies given; allowed"),
    ],
    ids=str,
)
def test_windows_that_do_not_fit(given_: Given, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        spwvd(noise(1), RATE, **given_)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("given_", "reason"),
    [
        ({"lag": 0.0}, "lag window: 0 s given; allowed: above 0 s, or inf"),
        ({"lag": np.nan}, "lag window: nan s given; allowed"),
        ({"time": -1.0}, "time window: -1 s given; allowed: 0 s and more"),
        ({"time": np.inf}, "time window: inf s given; allowed"),
        ({"band": (0.5, 0.5)}, "band: 0.5 to 0.5 Hz given; allowed: rising, within 0 to 30 Hz"),
        ({"band": (0.1, 31.0)}, "band: 0.1 to 31 Hz given"),
        ({"band": (-0.1, np.nan)}, "band: -0.1 to nan Hz given"),
    ],
    ids=str,
)
def test_analyses_that_a_record_cannot_give(given_: Given, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        analyse(T, np.cos(T), **given_)  # type: ignore[arg-type]


def test_too_short_records() -> None:
    with pytest.raises(InputError, match="1 known samples given; allowed: at least 16"):
        analyse(T, np.where(T == 0, 1.0, np.nan))
    with pytest.raises(InputError, match=r"1.1 s given; allowed: at least 1.6 s for this band"):
        analyse(T[:61], np.cos(T[:61]))
    assert np.isfinite(analyse(T[:100], np.cos(T[:100])).distribution.values).all()
