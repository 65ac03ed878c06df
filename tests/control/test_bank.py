"""Controllers side by side: what is acted on, when, and what a setpoint says; with lead-lags."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.control.bank import act, build_bank
from facts_damping.control.inputs import IMPLAUSIBLE, Wiring
from facts_damping.control.lead_lag import step
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.parameters.run import Controller
from facts_damping.signals import CHANNELS, SETPOINT
from tests.control.bench import FRAMES, LIMITS, MS, PMUS, SIGNALS, Bench, Entry, delivery, llc, settings_of

some = settings(deadline=None, max_examples=40)


def test_setpoint_is_not_issued_before_all_stations_have_arrived() -> None:
    """C is not part of the signal, and is not waited for."""
    bench = Bench(llc())
    assert len(bench.give(Entry("A", 0, 5))) == 0
    assert len(bench.give(Entry("C", 1, 6))) == 0
    assert len(bench.give(Entry("B", 0, 7, float("nan")))) == 0
    (setpoint,) = bench.give(Entry("B", 2, 9))
    assert setpoint["value"] == 0
    assert len(bench.give(Entry("A", 3, 10, float("nan")))) == 0
    assert len(bench.give(Entry("A", 4, 11))) == 1


def test_setpoint_says_when_and_from_what_it_was_made() -> None:
    bench = Bench(llc(), llc("power", "second"))
    bench.give(Entry("A", 0, 5), Entry("B", 0, 5), Entry("C", 0, 5), controller=1)
    (setpoint,) = bench.give(Entry("C", 10.5, 17.25, power=4.0), controller=1)
    assert (setpoint["tick"], setpoint["controller"], setpoint["device"]) == (1, 1, 1)
    assert setpoint["measured_ns"] == 10.5 * MS
    assert setpoint["issued_ns"] == setpoint["effective_ns"] == 17.25 * MS


def test_output_is_the_lead_lag_of_the_weighted_sum_at_the_times_of_measurement() -> None:
    """Weights 2 and -1; the step is the time between measurements, whatever the arrivals."""
    bench, state = Bench(llc(gain=3.0)), np.zeros(6)
    p = settings_of(llc(gain=3.0))[0]
    rng, measured = np.random.default_rng(1), 0.0
    for k in range(40):
        dt = 0.0 if k == 0 else float(rng.integers(5, 40))
        measured += dt
        a, b = rng.normal(size=2) * 1e-3
        arrival = measured + 30 + rng.uniform(0, 4)
        (setpoint,) = bench.give(Entry("A", measured, arrival, a), Entry("B", measured, arrival, b))
        assert setpoint["value"] == pytest.approx(step(p, state, 2 * a - b, dt * 1e-3), rel=1e-12)
    assert np.abs(state).max() > 1e-3


def test_held_value_stands_in_for_a_late_station() -> None:
    bench, state, p = Bench(llc()), np.zeros(6), settings_of(llc())[0]
    bench.give(Entry("A", 0, 1, 0.001), Entry("B", 0, 1, 0.002))
    step(p, state, 0.0, 0.0)
    (setpoint,) = bench.give(Entry("A", 20, 21, 0.003))
    assert setpoint["value"] == pytest.approx(step(p, state, 2 * 0.003 - 0.002, 0.02), rel=1e-12)
    assert setpoint["value"] != 0


def test_deviation_is_counted_from_the_first_value() -> None:
    bench, state = Bench(llc("power", "second", gain=0.1)), np.zeros(6)
    p = settings_of(llc("power", gain=0.1))[0]
    powers = [4.0, 4.1, 3.7]
    for k, power in enumerate(powers):
        (setpoint,) = bench.give(Entry("C", 20 * k, 20 * k, power=power))
        assert bench.state.held.signal[0, 0] == pytest.approx(power - 4.0, abs=1e-15)
        assert setpoint["value"] == pytest.approx(step(p, state, power - 4.0, 0.02 * (k > 0)), rel=1e-12)
    assert bench.state.held.baseline[0, 0] == 4.0


def test_setpoint_is_limited_by_the_limit_of_its_device() -> None:
    for device, (limit, _) in LIMITS.items():
        for sign in (1, -1):
            bench = Bench(llc(device=device))
            bench.give(Entry("A", 0, 0), Entry("B", 0, 0))
            (setpoint,) = bench.give(Entry("A", 20, 20, sign * 1.0))
            assert setpoint["value"] == sign * limit
            assert sign * bench.state.unlimited[0, 0] > limit


def test_entries_of_one_arrival_are_acted_on_once_and_others_each() -> None:
    bench = Bench(llc())
    setpoints = bench.give(
        Entry("A", 0, 5), Entry("B", 0, 5), Entry("C", 0, 5), Entry("A", 10, 12), Entry("B", 10, 12), Entry("A", 16, 15)
    )
    assert setpoints["issued_ns"].tolist() == [5 * MS, 12 * MS, 15 * MS]
    assert setpoints["measured_ns"].tolist() == [0, 10 * MS, 16 * MS]


def test_measurement_that_arrives_in_parts_acts_with_its_first_part() -> None:
    """A second arrival of the same measurement brings no newer frame: the setpoint stands."""
    bench = Bench(llc())
    bench.give(Entry("A", 0, 1), Entry("B", 0, 1))
    setpoints = bench.give(Entry("A", 20, 21, 0.001), Entry("B", 20, 22, 0.001))
    assert setpoints["issued_ns"].tolist() == [21 * MS]
    assert bench.state.held.entry[0, 1, list(CHANNELS).index("speed_deviation")] == 0.001


def test_frame_older_than_the_held_one_is_ignored() -> None:
    bench = Bench(llc())
    bench.give(Entry("A", 40, 41, 0.001), Entry("B", 40, 41))
    before, now = copy.deepcopy(bench.state), bench.state
    assert len(bench.give(Entry("A", 20, 60, 9.0))) == 0
    assert len(bench.give(Entry("A", 40, 61, 9.0))) == 0
    np.testing.assert_array_equal(before.outputs, now.outputs)
    np.testing.assert_array_equal(before.internal, now.internal)
    for earlier, held in zip(before.held, now.held, strict=True):
        np.testing.assert_array_equal(earlier, held)


def test_controllers_do_not_see_each_other() -> None:
    """Two controllers side by side issue what each would alone."""
    rng = np.random.default_rng(2)
    rows = [[Entry(s, 20 * k, 20 * k + 1, *rng.normal(size=2) * 1e-3) for s in PMUS] for k in range(20)]
    alone = [Bench(llc()), Bench(llc("power", "second", gain=2.0))]
    both = Bench(llc(), llc("power", "second", gain=2.0))
    for entries in rows:
        for c, single in enumerate(alone):
            (ours,), (theirs,) = both.give(*entries, controller=c), single.give(*entries)
            assert ours["value"] == theirs["value"]
            assert ours["device"] == c
    assert both.state.outputs[:, 0].tolist() == [float(b.state.outputs[0, 0]) for b in alone]


def test_empty_bank_has_no_controllers() -> None:
    empty, state = build_bank([], Wiring(SIGNALS, PMUS, LIMITS, FRAMES), [])
    assert empty.code.size == state.held.newest_ns.size == 0


@some
@given(data=st.data(), gain=st.floats(-1000, 1000))
def test_output_is_never_beyond_the_limit(data: st.DataObject, gain: float) -> None:
    """Any plausible input, any gaps: a finite setpoint for each new arrival, within the limit."""
    rows = st.tuples(
        st.sampled_from(["A", "B"]), st.integers(1, 500), st.floats(-0.99 * IMPLAUSIBLE, 0.99 * IMPLAUSIBLE)
    )
    bench, now = Bench(llc(gain=gain)), 0
    bench.give(Entry("A", 0, 0), Entry("B", 0, 0))
    for pmu, gap, speed in data.draw(st.lists(rows, max_size=20)):
        now += gap
        (setpoint,) = bench.give(Entry(pmu, now, now, speed))
        assert abs(setpoint["value"]) <= LIMITS["first"][0]


@pytest.mark.parametrize("speed", [IMPLAUSIBLE, -5e307, np.inf, np.nan])
def test_implausible_frame_is_not_acted_on_and_leaves_nothing_behind(speed: float) -> None:
    bench, plain = Bench(llc()), Bench(llc())
    for each_bench in (bench, plain):
        each_bench.give(Entry("A", 0, 0), Entry("B", 0, 0))
    assert len(bench.give(Entry("A", 20, 20, speed))) == 0
    (setpoint,), (expected,) = (single_bench.give(Entry("A", 40, 40, 0.001)) for single_bench in (bench, plain))
    assert setpoint["value"] == expected["value"] != 0


def test_deviation_is_counted_from_the_first_finite_value() -> None:
    bench = Bench(llc("power", "second"))
    assert len(bench.give(Entry("C", 0, 0, power=float("inf")))) == 0
    assert len(bench.give(Entry("C", 20, 20, power=4.0))) == 1
    assert bench.state.held.baseline[0, 0] == 4.0


def test_washout_takes_away_what_stays_and_starts_at_rest() -> None:
    """s T / (1 + s T) by the bilinear transform, whatever the time between frames; an offset of the start is none."""
    signals = {"washed": Signal(channel="active_power", weights={"C": 1.0}, washout=0.4)}
    row = Controller(signals=["washed"], devices=["first"])
    bench, rng = Bench(row, signals=signals), np.random.default_rng(1)
    x = y = t = before = 0.0
    for k in range(60):
        dt = float(rng.integers(10, 40)) * 1e-3 if k else 0.0
        t, power = t + dt, 4.0 + float(rng.normal()) * (k > 0)
        bench.give(Entry("C", 1e3 * t, 1e3 * t, power=power))
        a = 2 * 0.4 / dt if k else 0.0
        y = (a * (power - before) - (1 - a) * y) / (1 + a) if k else 0.0
        before = power
        assert bench.state.held.signal[0, 0] == pytest.approx(y, abs=1e-12)
        x = max(x, abs(y))
    assert x > 0.5
    for k in range(200):
        bench.give(Entry("C", 1e3 * t + 20 * (k + 1), 1e3 * t + 20 * (k + 1), power=7.0))
    assert abs(bench.state.held.signal[0, 0]) < 1e-3


def test_angle_is_the_difference_the_short_way_round() -> None:
    signals = {"angle": Signal(channel="voltage_angle", weights={"A": 1.0, "B": -1.0})}
    bench = Bench(Controller(signals=["angle"], devices=["first"]), signals=signals)
    column = list(CHANNELS).index("voltage_angle")
    for k, (a, b, expected) in enumerate([(0.3, 0.1, 0.2), (3.1, -3.1, 6.2 - 2 * np.pi), (-3.0, 3.1, 2 * np.pi - 6.1)]):
        delivered, out = delivery(Entry("A", 20 * k, 20 * k), Entry("B", 20 * k, 20 * k)), np.zeros(4, SETPOINT)
        delivered["values"][:, column] = [a, b]
        act(bench.bank, bench.state, 0, k, delivered, 2, out, 0)
        assert bench.state.held.signal[0, 0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("weights", [{"A": 1.0}, {"A": 1.0, "B": -2.0}, {"A": 0.5, "B": -0.5}])
def test_angle_against_nothing_or_by_parts_is_refused(weights: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="must be whole and sum to zero"):
        Signal(channel="voltage_angle", weights=weights)
