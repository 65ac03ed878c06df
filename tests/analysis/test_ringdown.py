"""The matrix pencil on signals whose modes are known."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping import loop
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.ringdown import ringdown_modes
from facts_damping.configuration import load_case
from facts_damping.loop import run
from facts_damping.plant import linear
from facts_damping.plant.build import build as build_plant

if TYPE_CHECKING:
    from numpy.typing import NDArray

T = np.arange(1200) / 60


def wave(frequency: float, ratio: float, amplitude: float = 1e-3, phase: float = 0.3) -> NDArray[np.float64]:
    omega = 2 * np.pi * frequency
    return np.asarray(amplitude * np.exp(-omega * ratio / np.sqrt(1 - ratio**2) * T) * np.cos(omega * T + phase))


@pytest.mark.parametrize("slow", [0.0, 0.3 + 0.01 * T, 5e-3 * np.exp(-T / 8)], ids=["none", "line", "exponential"])
@pytest.mark.parametrize("rate", [30, 60])
def test_two_modes_exactly(slow: float, rate: int) -> None:
    x = (wave(0.55, 0.05) + wave(1.1, 0.04, 6e-4, 1.0) + slow)[:: 60 // rate]
    found = ringdown_modes(T[:: 60 // rate], x, 1.0)
    assert [mode.frequency_hz for mode in found] == pytest.approx([0.55, 1.1], rel=1e-6)
    assert [mode.damping_ratio for mode in found] == pytest.approx([0.05, 0.04], rel=1e-6)


@given(frequency=st.floats(0.15, 2.4), ratio=st.floats(-0.04, 0.15), amplitude=st.floats(1e-5, 1e-1))
@settings(deadline=None)
def test_one_mode(frequency: float, ratio: float, amplitude: float) -> None:
    (mode,) = ringdown_modes(T, wave(frequency, ratio, amplitude))
    assert mode.frequency_hz == pytest.approx(frequency, rel=1e-6)
    assert mode.damping_ratio == pytest.approx(ratio, abs=1e-6)


def test_signals_share_their_modes() -> None:
    x = np.column_stack([wave(0.6, 0.03), wave(1.05, 0.05), wave(1.2, 0.06) - wave(0.6, 0.03)])
    found = ringdown_modes(T, x)
    assert sorted(mode.frequency_hz for mode in found) == pytest.approx([0.6, 1.05, 1.2], rel=1e-6)


@given(seed=st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
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
def test_nothing_swings(signal: NDArray[np.float64]) -> None:
    assert ringdown_modes(T, signal) == []


def test_too_little_left() -> None:
    assert ringdown_modes(T, wave(0.5, 0.05), 17.0) == []
    assert ringdown_modes(T, wave(0.5, 0.05), 30.0) == []


def test_small_disturbance_shows_the_mode_of_the_linearised_plant() -> None:
    step = "scenario=[{time: 1.0, kind: load_step, load: load_2, change: -0.001}]"
    case = load_case("two_area_small", ["controllers=[]", step])
    built = build_plant(case.system, case.run.devices, case.scenario.events)
    known = min(
        linear.modes(linear.linearise(built)[0], built.state_names), key=lambda mode: abs(mode.frequency_hz - 0.6)
    )
    record = run(case)
    (found,) = ringdown_modes(record.time_s, columns(speed_differences(record)), 1.0)
    assert found.frequency_hz == pytest.approx(known.frequency_hz, rel=1e-3)
    assert found.damping_ratio == pytest.approx(known.damping_ratio, abs=2e-4)


def test_poles_that_grow_do_not_hide_the_modes() -> None:
    """Two controllers damp `small`: the linear loop has its swings at 0.65 and 1.15 Hz, and spurious poles grow."""
    own = {"name": "LLC", "devices": ["sssc"], "signals": ["speed"]}
    other = {"name": "LLC", "devices": ["statcom"], "signals": ["power"], "parameters": {"gain": 0.1}}
    plain = ["system.signals.power.washout=0", "system.signals.power.deviation=true"]
    record = loop.run(load_case(None, ["devices=[sssc, statcom]", f"controllers={json.dumps([own, other])}", *plain]))
    found = ringdown_modes(record.time_s, columns(speed_differences(record)), 1.0)
    assert found[0].frequency_hz == pytest.approx(0.651, abs=0.005)
    assert found[0].damping_ratio == pytest.approx(0.050, abs=0.003)
    assert all(mode.damping_ratio > 0 for mode in found)
