"""Modes of signals that are known, by all methods; what nothing else than the matrix pencil is used for by it alone."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.poles import METHODS
from facts_damping.analysis.modes.ringdown import Fit, fit_ringdown, interval, ringdown_modes
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.plant.build import build as build_plant
from facts_damping.simulation import loop
from facts_damping.simulation.loop import run
from facts_damping.small_signal import eigenmodes, linearisation

if TYPE_CHECKING:
    from numpy.typing import NDArray

T = np.arange(1200) / 60


def wave(frequency: float, ratio: float, amplitude: float = 1e-3, phase: float = 0.3) -> NDArray[np.float64]:
    omega = 2 * np.pi * frequency
    return np.asarray(amplitude * np.exp(-omega * ratio / np.sqrt(1 - ratio**2) * T) * np.cos(omega * T + phase))


def fit(t: NDArray[np.float64], x: NDArray[np.float64], method: str, since: float = 0.0) -> Fit:
    fitted = fit_ringdown(t, x, since, method)
    assert fitted is not None
    return fitted


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("slow", [0.0, 0.3 + 0.01 * T, 5e-3 * np.exp(-T / 8)], ids=["none", "line", "exponential"])
@pytest.mark.parametrize("rate", [30, 60])
def test_two_modes_exactly(slow: float, rate: int, method: str) -> None:
    x = (wave(0.55, 0.05) + wave(1.1, 0.04, 6e-4, 1.0) + slow)[:: 60 // rate]
    modes = fit(T[:: 60 // rate], x, method, 1.0).modes
    assert [mode.frequency_hz for mode in modes] == pytest.approx([0.55, 1.1], rel=1e-6)
    assert [mode.damping_ratio for mode in modes] == pytest.approx([0.05, 0.04], rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
@given(frequency=st.floats(0.15, 2.4), ratio=st.floats(-0.04, 0.15), amplitude=st.floats(1e-5, 1e-1))
@settings(deadline=None, max_examples=15)
def test_single_mode_is_found_with_frequency_and_damping(
    method: str, frequency: float, ratio: float, amplitude: float
) -> None:
    (mode,) = fit(T, wave(frequency, ratio, amplitude), method).modes
    assert mode.frequency_hz == pytest.approx(frequency, rel=1e-6)
    assert mode.damping_ratio == pytest.approx(ratio, abs=1e-6)


@pytest.mark.parametrize("method", METHODS)
@given(scale=st.floats(1e-3, 1e3), late=st.integers(0, 120), shift=st.floats(0, 1000))
@settings(deadline=None, max_examples=8)
def test_neither_scale_nor_time_moves_the_modes(method: str, scale: float, late: int, shift: float) -> None:
    x = wave(0.6, 0.05) + wave(1.1, 0.04, 6e-4, 1.0)
    noisy = x + 1e-6 * np.random.default_rng(5).standard_normal(len(T))
    here, there = (fit(t, y, method, t[late] - 0.005) for t, y in ((T, noisy), (T + shift, scale * noisy)))
    for mode, other in zip(here.modes, there.modes, strict=True):
        assert other.frequency_hz == pytest.approx(mode.frequency_hz, rel=1e-7)
        assert other.damping_ratio == pytest.approx(mode.damping_ratio, abs=1e-7)
        assert other.damping_ratio_error == pytest.approx(mode.damping_ratio_error, rel=1e-4)
        assert other.amplitude == pytest.approx(scale * np.array(mode.amplitude), rel=1e-4)
    assert there.snr_db == pytest.approx(here.snr_db, abs=1e-3)
    assert there.start_s == pytest.approx(here.start_s + shift)


@pytest.mark.parametrize("method", METHODS)
def test_amplitudes_and_phases_are_those_at_the_start(method: str) -> None:
    x = np.column_stack([wave(0.6, 0.05, 2e-3, 0.4) + wave(1.1, 0.04, 6e-4, 1.0), wave(0.6, 0.05, 1e-3, -2.0)])
    fitted = fit(T, x, method, 1.0)
    strong, weak = fitted.modes
    assert fitted.start_s == 2.0
    for mode, place, amplitude, phase in ((strong, 0, 2e-3, 0.4), (strong, 1, 1e-3, -2.0), (weak, 0, 6e-4, 1.0)):
        s = 2 * np.pi * mode.frequency_hz * (1j - mode.damping_ratio / np.sqrt(1 - mode.damping_ratio**2))
        there = amplitude * np.exp(1j * phase + s * fitted.start_s)
        assert mode.amplitude[place] * np.exp(1j * mode.phase_rad[place]) == pytest.approx(there, rel=1e-6)
    assert weak.amplitude[1] < 1e-9
    assert fitted.snr_db > 150
    assert strong.frequency_error_hz < 1e-9


def ten_seconds(ratio: float, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """11 s at 60 Hz, of which a fit uses 10, with an interarea and a local mode and noise of 40 dB."""
    t = T[:660]
    x = (wave(0.6, ratio) + wave(1.1, 0.06, 6e-4, 1.0))[:660]
    noise = 0.01 * np.sqrt(np.mean(x[60:] ** 2)) * np.random.default_rng(seed).standard_normal(660)
    return t, x + noise


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ratio", [0.03, 0.06, 0.1])
def test_ten_seconds_with_noise_of_40_db(method: str, ratio: float) -> None:
    quality = []
    for seed in range(20):
        fitted = fit(*ten_seconds(ratio, seed), method)
        quality.append(fitted.snr_db)
        slow, fast = sorted(fitted.modes)  # as many as there are
        assert slow.frequency_hz == pytest.approx(0.6, rel=0.005)
        assert slow.damping_ratio == pytest.approx(ratio, abs=0.005)
        assert fast.frequency_hz == pytest.approx(1.1, rel=0.005)
        assert fast.damping_ratio == pytest.approx(0.06, abs=0.005)
    # Means of six samples have a sixth of the noise's power; of 100 samples about 10 degrees of freedom are fitted.
    assert np.mean(quality) == pytest.approx(40 + 10 * np.log10(6 / 0.9), abs=0.7)


@pytest.mark.parametrize("method", METHODS)
def test_intervals_hold_the_truth_as_often_as_they_say(method: str) -> None:
    held = []
    for seed in range(200):
        slow, fast = sorted(fit(*ten_seconds(0.06, 1000 + seed), method).modes)
        for mode, frequency, ratio in ((slow, 0.6, 0.06), (fast, 1.1, 0.06)):
            for value, error, true in (
                (mode.frequency_hz, mode.frequency_error_hz, frequency),
                (mode.damping_ratio, mode.damping_ratio_error, ratio),
            ):
                low, high = interval(value, error)
                held.append(low <= true <= high)
    fraction = np.mean(np.reshape(held, (200, 4)), axis=0)
    assert (fraction >= 0.9).all()
    assert (fraction <= 0.99).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("count", [1, 2, 3])
def test_as_many_modes_as_there_are(method: str, count: int) -> None:
    some = [wave(0.5, 0.04), wave(1.0, 0.05, 8e-4, 2.0), wave(1.6, 0.03, 7e-4, -1.0)][:count]
    for seed in range(10):
        noise = 5e-6 * np.random.default_rng(seed).standard_normal(len(T))
        assert len(fit(T, np.sum(some, axis=0) + noise, method).modes) == count


@pytest.mark.parametrize("method", METHODS)
def test_signals_share_their_modes(method: str) -> None:
    x = np.column_stack([wave(0.6, 0.03), wave(1.05, 0.05), wave(1.2, 0.06) - wave(0.6, 0.03)])
    modes = fit(T, x, method).modes
    assert sorted(mode.frequency_hz for mode in modes) == pytest.approx([0.6, 1.05, 1.2], rel=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_roots_that_cancel_each_other_are_not_taken_for_modes(method: str) -> None:
    """With this noise linear prediction has three useless roots side by side, of more energy than the local mode."""
    t = T[:660]
    s = 2 * np.pi * np.array([0.6, 1.1]) * (1j - 0.06 / np.sqrt(1 - 0.06**2))
    x = (np.exp(np.outer(t, s)) @ [1e-3, 6e-4]).real
    noise = 0.01 * np.sqrt(np.mean(x[60:] ** 2)) * np.random.default_rng(101).standard_normal(660)
    slow, fast = sorted(fit(t, x + noise, method).modes)
    assert slow.frequency_hz == pytest.approx(0.6, rel=0.005)
    assert fast.frequency_hz == pytest.approx(1.1, rel=0.005)


def test_unknown_method_is_refused() -> None:
    with pytest.raises(InputError, match=r"method: 'music' given; allowed: matrix_pencil, prony, era"):
        fit_ringdown(T, wave(0.6, 0.05), method="music")


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=12)
def test_noise_moves_the_modes_a_little(seed: int) -> None:
    noise = 1e-5 * np.random.default_rng(seed).standard_normal(1200)
    mode = ringdown_modes(T, wave(0.55, 0.05) + noise, 1.0)[0]
    assert mode.frequency_hz == pytest.approx(0.55, abs=2e-3)
    assert mode.damping_ratio == pytest.approx(0.05, abs=5e-3)


def test_one_oscillation_with_changing_frequency_is_one_mode() -> None:
    amplitude = 1e-3 * np.exp(0.05 * T)
    x = amplitude * np.sin(2 * np.pi * 0.6 * T - 10 * amplitude * T)
    assert len(ringdown_modes(T, x)) == 1


def test_only_the_band_and_what_matters() -> None:
    x = wave(0.55, 0.05) + wave(4.0, 0.02) + wave(0.05, 0.0) + wave(1.5, 0.05, 1e-5)
    assert [mode.frequency_hz for mode in ringdown_modes(T, x)] == pytest.approx([0.55], rel=1e-6)


@pytest.mark.parametrize("signal", [np.zeros(1200), 1e-3 * T, np.full(1200, np.nan), 1e-11 * wave(0.5, 0)], ids=str)
def test_signal_without_oscillation_has_no_modes(signal: NDArray[np.float64]) -> None:
    assert ringdown_modes(T, signal) == []
    assert all(fit_ringdown(T, signal, method=method) is None for method in METHODS)


def test_too_little_left() -> None:
    assert ringdown_modes(T, wave(0.5, 0.05), 17.0) == []
    assert ringdown_modes(T, wave(0.5, 0.05), 30.0) == []


def test_small_disturbance_shows_the_mode_of_the_linearised_plant() -> None:
    step = "scenario=[{time: 1.0, kind: load_step, load: load_2, change: -0.001}]"
    case = load_case("two_area_small", ["controllers=[]", step])
    built = build_plant(case.system, case.run.devices, case.scenario.events)
    known = min(
        eigenmodes.modes(linearisation.linearise(built)[0], built.state_names),
        key=lambda mode: abs(mode.frequency_hz - 0.6),
    )
    record = run(case)
    for method in METHODS:
        (ringing,) = fit(record.time_s, columns(speed_differences(record)), method, 1.0).modes
        assert ringing.frequency_hz == pytest.approx(known.frequency_hz, rel=1e-3)
        assert ringing.damping_ratio == pytest.approx(known.damping_ratio, abs=2e-4)


def test_poles_that_grow_do_not_hide_the_modes() -> None:
    """Two controllers damp `small`: the linear loop has its swings at 0.65 and 1.15 Hz, and spurious poles grow."""
    first = {"name": "LLC", "devices": ["sssc"], "signals": ["speed"]}
    other = {"name": "LLC", "devices": ["statcom"], "signals": ["power"], "parameters": {"gain": 0.1}}
    plain = ["system.signals.power.washout=0", "system.signals.power.deviation=true"]
    record = loop.run(load_case(None, ["devices=[sssc, statcom]", f"controllers={json.dumps([first, other])}", *plain]))
    modes = ringdown_modes(record.time_s, columns(speed_differences(record)), 1.0)
    assert modes[0].frequency_hz == pytest.approx(0.651, abs=0.005)
    assert modes[0].damping_ratio == pytest.approx(0.050, abs=0.003)
    assert all(mode.damping_ratio > 0 for mode in modes)
