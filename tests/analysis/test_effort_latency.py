"""Smoothness, peak voltage, latency and losses of records made to measure."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facts_damping.analysis.effort import max_injected_voltage, record_smoothness, smoothness
from facts_damping.analysis.latency import frames_lost, latency
from facts_damping.signals import DEVICE_TRUTH, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.signals import Record


def test_smoothness_of_a_parabola_is_its_curvature() -> None:
    t = np.arange(100) / 60
    assert smoothness(3 * t**2, 1 / 60) == pytest.approx(6.0)
    assert smoothness(3 * t**2) == pytest.approx(6.0 / 3600)


@given(omega=st.floats(0.5, 30))
def test_smoothness_of_a_sine(omega: float) -> None:
    # Second difference of sin(wt): -4 sin^2(w dt / 2) sin(wt); its mean square over whole periods is half.
    dt = 2 * np.pi / omega / 100
    t = dt * np.arange(1002)
    expected = 4 * np.sin(omega * dt / 2) ** 2 / np.sqrt(2)
    assert smoothness(np.sin(omega * t).astype(np.float64), dt) == pytest.approx(expected / dt**2, rel=1e-3)


@given(slope=st.floats(-10, 10), offset=st.floats(-10, 10))
def test_straight_lines_are_smooth(slope: float, offset: float) -> None:
    assert smoothness(slope * np.linspace(0, 49, 50) + offset) == pytest.approx(0, abs=1e-12)


def test_too_short_or_no_device() -> None:
    assert smoothness(np.array([1.0, 2.0])) == 0
    assert smoothness(np.zeros((50, 0))) == 0


def test_record_smoothness(swing_record: Callable[..., Record]) -> None:
    found = record_smoothness(swing_record())
    assert found["per_second"] == pytest.approx(3600 * found["per_frame"], rel=1e-6)
    assert found["per_frame"] > 0


def test_peak_voltage(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    assert max_injected_voltage(record) == np.abs(record.devices["injected_voltage"]).max()
    assert max_injected_voltage(swing_record(devices=np.zeros((1200, 0), DEVICE_TRUTH))) is None
    record.devices["injected_voltage"] = np.nan  # a STATCOM alone
    assert max_injected_voltage(record) is None


def test_latency(swing_record: Callable[..., Record]) -> None:
    applied = np.zeros(101, SETPOINT)
    applied["effective_ns"] = np.arange(101) * 1_000_000
    found = latency(swing_record(applied=applied))
    assert found == pytest.approx({"mean": 50, "p50": 50, "p99": 99, "max": 100})
    nothing = latency(swing_record(applied=applied[:0]))
    assert nothing == {"mean": None, "p50": None, "p99": None, "max": None}


@given(seed=st.integers(0, 2**32 - 1), lost=st.integers(0, 50))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_frames_lost(swing_record: Callable[..., Record], seed: int, lost: int) -> None:
    record = swing_record(200)
    random = np.random.default_rng(seed)
    # The newest entry of each station stays: what comes after it counts as still under way.
    dropped = random.choice(len(record.delivered) - 3, lost, replace=False)
    kept = random.permutation(np.delete(record.delivered, dropped))
    assert frames_lost(swing_record(200, delivered=kept)) == lost


def test_entries_under_way_are_not_lost(swing_record: Callable[..., Record]) -> None:
    record = swing_record(200)
    assert frames_lost(record) == 0
    assert frames_lost(swing_record(200, delivered=record.delivered[:0])) == 0


def test_frames_lost_count_for_each_link_by_itself(swing_record: Callable[..., Record]) -> None:
    """What one link delivers does not make up for what another loses; a link that is later has more under way."""
    first = swing_record(200).delivered
    second = first[first["measured_ns"] < first["measured_ns"][-30]].copy()
    second["link"] = 1
    assert frames_lost(swing_record(200, delivered=np.concatenate([first, second]))) == 0
    holes = np.concatenate([first, np.delete(second, [0, 50, 51])])
    assert frames_lost(swing_record(200, delivered=holes)) == 3
    assert frames_lost(swing_record(200, delivered=np.concatenate([np.delete(first, 7), second]))) == 1
