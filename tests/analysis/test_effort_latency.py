"""Roughness, peak voltage, latency and losses of records made to measure."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facts_damping.analysis.effort import max_injected_voltage, record_roughness, roughness, saturation_duty
from facts_damping.analysis.latency import ages_ms, cdf, frames_lost, hops_ms, latency, left_out
from facts_damping.api import simulate
from facts_damping.case.loading import load_case
from facts_damping.signals import DEVICE_TRUTH, SETPOINT
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.record import Record


def test_roughness_of_a_parabola_is_its_curvature() -> None:
    t = np.arange(100) / 60
    assert roughness(3 * t**2, 1 / 60) == pytest.approx(6.0)
    assert roughness(3 * t**2) == pytest.approx(6.0 / 3600)


@given(omega=st.floats(0.5, 30))
def test_roughness_of_a_sine(omega: float) -> None:
    # Second difference of sin(wt): -4 sin^2(w dt / 2) sin(wt); its mean square over whole periods is half.
    dt = 2 * np.pi / omega / 100
    t = dt * np.arange(1002)
    expected = 4 * np.sin(omega * dt / 2) ** 2 / np.sqrt(2)
    assert roughness(np.sin(omega * t).astype(np.float64), dt) == pytest.approx(expected / dt**2, rel=1e-3)


@given(slope=st.floats(-10, 10), offset=st.floats(-10, 10))
def test_straight_lines_are_smooth(slope: float, offset: float) -> None:
    assert roughness(slope * np.linspace(0, 49, 50) + offset) == pytest.approx(0, abs=1e-12)


def test_too_short_or_no_device() -> None:
    assert roughness(np.array([1.0, 2.0])) == 0
    assert roughness(np.zeros((50, 0))) == 0


def test_record_roughness(swing_record: Callable[..., Record]) -> None:
    roughness_found = record_roughness(swing_record())
    assert roughness_found["per_second"] == pytest.approx(3600 * roughness_found["per_frame"], rel=1e-6)
    assert roughness_found["per_frame"] > 0


def test_peak_voltage(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    assert max_injected_voltage(record) == np.abs(record.devices["injected_voltage"]).max()
    assert max_injected_voltage(swing_record(devices=np.zeros((1200, 0), DEVICE_TRUTH))) is None
    record.devices["injected_voltage"] = np.nan  # a STATCOM alone
    assert max_injected_voltage(record) is None


def test_latency(swing_record: Callable[..., Record]) -> None:
    applied = np.zeros(101, SETPOINT)
    applied["effective_ns"] = np.arange(101) * 1_000_000
    latencies = latency(swing_record(applied=applied))
    assert latencies._asdict() == pytest.approx({"mean": 50, "p50": 50, "p99": 99, "max": 100})
    nothing = latency(swing_record(applied=applied[:0]))
    assert nothing == (None, None, None, None)


def test_latencies_that_cannot_be_are_left_out(swing_record: Callable[..., Record]) -> None:
    applied = np.zeros(4, SETPOINT)
    applied["effective_ns"] = applied["measured_ns"] + 20_000_000
    applied["measured_ns"][1:3] = [2**60, -5]  # a clock of another year, and of a time before the run
    record = swing_record(applied=applied)
    assert latency(record)._asdict() == pytest.approx({"mean": 20, "p50": 20, "p99": 20, "max": 20})
    assert left_out(record) == 2
    applied["tick"][3] = 600  # a node that stood still for ten seconds: its setpoint acts when it comes
    assert latency(record).max == pytest.approx(1e4)
    assert hops_ms(record)["whole"]["sssc"].tolist() == pytest.approx([20, 1e4])


@given(seed=st.integers(0, 2**32 - 1), lost=st.integers(0, 50))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_frames_lost(swing_record: Callable[..., Record], seed: int, lost: int) -> None:
    record = swing_record(200)
    random = np.random.default_rng(seed)
    dropped = random.choice(len(record.delivered), lost, replace=False)
    arrived = random.permutation(np.delete(record.delivered, dropped))
    assert frames_lost(swing_record(200, delivered=arrived)) == lost


def test_entries_under_way_are_not_lost(swing_record: Callable[..., Record]) -> None:
    record = swing_record(200)
    assert frames_lost(record) == 0
    assert frames_lost(swing_record(200, delivered=record.delivered[record.delivered["measured_ns"] < 10**9])) > 0


def test_frame_that_never_arrives_is_lost_also_at_the_end(swing_record: Callable[..., Record]) -> None:
    """A PMU that falls silent, one that was never heard, and a link that brings nothing at all."""
    record = swing_record(200)
    rows = record.delivered
    silent = (rows["pmu"] == 1) & (rows["measured_ns"] >= record.time_ns[120])
    assert frames_lost(swing_record(200, delivered=rows[~silent])) == 194 - 120
    assert frames_lost(swing_record(200, delivered=rows[rows["pmu"] != 1])) == 194
    assert frames_lost(swing_record(200, delivered=rows[:0])) == 3 * 200
    assert frames_lost(swing_record(200, links=2)) == 3 * 194


def test_of_a_link_that_is_cut_all_is_lost_to_the_end() -> None:
    """From 5 s on nothing gets through; what left the PMUs before that and is 100 ms late arrives."""
    cut = {"stage": "network", "model": "bernoulli", "loss": 1.0, "start": 5.0}
    record = simulate(link={"up": [{"stage": "network", "delay": 0.1}, cut]})
    # The last 100 ms may be under way, for all that the record tells: six frames.
    assert frames_lost(record) == len(record.pmus) * (15 * 60 - 6)
    assert frames_lost(simulate(link={"up": [cut]})) == len(record.pmus) * 15 * 60
    assert frames_lost(simulate(link={"up": [{"stage": "network", "delay": 0.1}]})) == 0


def test_frames_lost_count_for_each_link_by_itself(swing_record: Callable[..., Record]) -> None:
    """What one link delivers does not make up for what another loses; a link that is later has more under way."""
    first = swing_record(200).delivered
    second = first[first["measured_ns"] < first["measured_ns"][-30]].copy()
    second["link"] = 1
    second["arrival_ns"] += 166_666_666

    def lost(delivered: NDArray[Any]) -> int:
        return frames_lost(swing_record(200, delivered=delivered, links=2))

    assert lost(np.concatenate([first, second])) == 0
    holes = np.concatenate([first, np.delete(second, [0, 50, 51])])
    assert lost(holes) == 3
    assert lost(np.concatenate([np.delete(first, 7), second])) == 1


def test_saturation_duty_of_each_device(swing_record: Callable[..., Record]) -> None:
    record = swing_record()
    record.devices["setpoint"][:, 0] = np.where(np.arange(1200) % 4 == 0, -0.1, 0.0999)
    assert saturation_duty(record) == {"sssc": 0.25}
    assert saturation_duty(swing_record(configuration={})) == {}


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_cdf_is_the_share_that_is_not_above(values: list[float]) -> None:
    x, fraction = cdf(np.array(values))
    for point, part in zip(x, fraction, strict=True):
        assert part <= np.mean(np.array(values) <= point) + 1e-12
    assert fraction[-1] == 1.0
    assert x.tolist() == sorted(values)


def test_hops_of_constant_delays(swing_record: Callable[..., Record]) -> None:
    record = swing_record(100)
    record.delivered["arrival_ns"] = record.delivered["measured_ns"] + 80_000_000
    record.delivered["arrival_ns"][record.delivered["pmu"] == 1] += 5_000_000  # for it the controller waits
    record.applied["issued_ns"] = record.applied["measured_ns"] + 85_000_000
    record.issued["issued_ns"] = record.applied["issued_ns"]
    hops = hops_ms(record)
    assert {who: set(values.tolist()) for who, values in hops["up"].items()} == {"G1": {80}, "G2": {85}, "TIE": {80}}
    assert set(hops["wait"]["controller_0_LLC"].tolist()) == {5}
    assert set(hops["down"]["sssc"].tolist()) == {35}
    assert np.array_equal(hops["whole"]["sssc"], ages_ms(record))


def test_latency_of_a_controller_is_that_of_its_own_link() -> None:
    """Of two controllers the second has a link of its own, with 60 ms up; neither waits, for a link delivers whole."""
    slow = {"up": [{"stage": "network", "model": "constant", "delay": 0.06}], "down": []}
    controllers = [
        {"name": "LLC", "devices": ["sssc"], "signals": ["speed"]},
        {"name": "LLC", "devices": ["statcom"], "signals": ["power"], "link": slow},
    ]
    sets = ["devices=[sssc, statcom]", f"controllers={json.dumps(controllers)}", "link=delay_100ms", "duration=3"]
    record = loop.run(load_case("two_area_small", sets))
    hops = hops_ms(record)
    assert {name for name in hops["up"] if name.startswith("G1")} == {"G1/0", "G1/1"}
    assert set(hops["up"]["G1/0"].tolist()) == {70}
    assert set(hops["up"]["G1/1"].tolist()) == {60}
    assert [set(hops["wait"][name].tolist()) for name in record.controller_names] == [{0.0}, {0.0}]
    assert set(hops["down"]["sssc"].tolist()) == {30}
    assert set(hops["whole"]["statcom"].tolist()) == {60}
