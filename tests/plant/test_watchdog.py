"""The device watchdog: what it takes, when it lets go, how it comes back; over random setpoints, too."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.analysis.summary import summarise
from facts_damping.analysis.summary_table import table
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.parameters.plant.watchdog import Watchdog
from facts_damping.plant import watchdog
from facts_damping.plant.integration import advance
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import NOT_YET, SETPOINT, to_ns
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_plant
from facts_damping.simulation.measured_plant import tick_ns

if TYPE_CHECKING:
    from facts_damping.plant.build import Built

RATE = 60
TICK = -(-1_000_000_000 // RATE)
MS = 1_000_000
LIMIT = 0.1
CUT = '{"up": [{"model": "bernoulli", "loss": 1.0, "start": 2.5}]}'


def setpoint(now: int, **fields: Any) -> Any:
    row = np.zeros(1, SETPOINT)
    row["measured_ns"] = row["issued_ns"] = row["effective_ns"] = now
    row["value"] = 0.01
    for name, value in fields.items():
        row[name] = value
    return row


def settings_row(**fields: Any) -> Any:
    return np.array([watchdog.settings(Watchdog(**fields), RATE)])


# What differs from a good setpoint 1 s after the start, the one before having been issued at 0.9 s on 0.8 s; its count.
ODD: dict[str, tuple[dict[str, Any], str]] = {
    "not a number": ({"value": np.nan}, "refused_value"),
    "infinite": ({"value": -np.inf}, "refused_value"),
    "beyond the limit": ({"value": np.nextafter(LIMIT, 1.0)}, "refused_value"),
    "from the future": ({"measured_ns": 1000 * MS + TICK + 1}, "refused_stamp"),
    "issued in the future": ({"issued_ns": 1000 * MS + TICK + 1}, "refused_stamp"),
    "stamped 2038": ({"measured_ns": 2**31 * 1_000_000_000}, "refused_stamp"),
    "too old": ({"measured_ns": 500 * MS - 1}, "refused_stamp"),
    "the same once more": ({"issued_ns": 900 * MS, "measured_ns": 800 * MS}, "refused_order"),
    "overtaken": ({"issued_ns": 900 * MS - 1}, "refused_order"),
}
GOOD: dict[str, dict[str, Any]] = {
    "fresh": {},
    "at the limit": {"value": -LIMIT},
    "as old as may be": {"measured_ns": 500 * MS},
    "a tick ahead": {"measured_ns": 1000 * MS + TICK, "issued_ns": 1000 * MS + TICK},
    "issued at the same time on newer data": {"issued_ns": 900 * MS, "measured_ns": 800 * MS + 1},
}


def judged(fields: dict[str, Any]) -> tuple[bool, Any]:
    row, watch = settings_row(max_age=0.5), watchdog.initial_watch(1)
    first = setpoint(900 * MS, measured_ns=800 * MS)
    assert watchdog.accepts(row[0], watch[0], first[0], LIMIT, 900 * MS)
    return watchdog.accepts(row[0], watch[0], setpoint(1000 * MS, **fields)[0], LIMIT, 1000 * MS), watch[0]


@pytest.mark.parametrize("name", ODD)
def test_odd_setpoint_is_refused_and_counted_by_cause(name: str) -> None:
    fields, cause = ODD[name]
    accepted, watch = judged(fields)
    assert not accepted
    counts = {field: int(watch[field]) for field in ("refused_value", "refused_stamp", "refused_order")}
    assert counts == {**dict.fromkeys(counts, 0), cause: 1}
    assert watch["accepted_ns"] == 900 * MS


@pytest.mark.parametrize("name", GOOD)
def test_good_setpoint_is_accepted(name: str) -> None:
    accepted, watch = judged(GOOD[name])
    assert accepted
    assert watch["accepted_ns"] == 1000 * MS


def test_watchdog_that_is_off_refuses_only_what_is_no_number() -> None:
    row, watch = np.array([watchdog.settings(None, RATE)]), watchdog.initial_watch(1)
    for name, (fields, _) in ODD.items():
        accepted = watchdog.accepts(row[0], watch[0], setpoint(1000 * MS, **fields)[0], LIMIT, 1000 * MS)
        assert accepted == (name not in ("not a number", "infinite"))
    assert watch.tobytes() == watchdog.initial_watch(1).tobytes()


def test_watchdog_that_refuses_nothing_changes_no_bit() -> None:
    """On or off: whole runs over the shipped links, also those with jitter in order."""
    for link in ("ideal", "fibre", "satellite"):
        on, off = (loop.run(load_case(None, [f"link={link}", "duration=6", *more])) for more in ([], ["watchdog=off"]))
        for name in ("frames", "machines", "devices", "applied"):
            assert getattr(on, name).tobytes() == getattr(off, name).tobytes(), (link, name)


@pytest.mark.parametrize("timeout", [0.2, 0.3104])
def test_device_lets_go_to_the_instant_and_stays_at_zero(timeout: float) -> None:
    """Total loss from 2.5 s on: the last setpoint for `timeout`, then to zero at the release rate."""
    more = ["scenario=large", "duration=4", f"link={CUT}"]
    held = loop.run(load_case(None, [*more, "watchdog=off"]))
    let_go = loop.run(load_case(None, [*more, f"watchdog.timeout={timeout}", "watchdog.release_rate=0.05"]))
    since = int(held.applied["effective_ns"].max()) + to_ns(timeout)
    after = held.time_ns >= since
    for name in ("frames", "machines", "devices"):
        assert getattr(held, name)[~after].tobytes() == getattr(let_go, name)[~after].tobytes()
    at_end = float(held.devices["setpoint"][-1, 0])
    assert abs(at_end) > 0.005
    reference, late = let_go.devices["reference"][after, 0], (let_go.time_ns[after] - since) * 1e-9
    wanted = np.sign(at_end) * np.maximum(abs(at_end) - 0.05 * late, 0.0)
    assert (wanted != 0.0).sum() > 5
    np.testing.assert_allclose(reference, wanted, atol=1e-9)
    # A measurement at the very instant is taken before anything is done.
    assert (let_go.devices["released"][let_go.time_ns > since, 0] == 1.0).all()
    assert (let_go.devices["released"][let_go.time_ns < since, 0] == 0.0).all()
    assert (held.devices["setpoint"][after, 0] == at_end).all()


def test_device_that_never_had_a_setpoint_is_not_released() -> None:
    record = loop.run(load_case(None, ["controllers=[]", "duration=2"]))
    assert not record.devices["released"].any()
    assert summarise(record).releases == []


def gap(more: list[str]) -> Any:
    """A loss of half a second from 2.5 s on."""
    link = '{"up": [{"model": "bernoulli", "loss": 1.0, "start": 2.5, "duration": 0.5}]}'
    return loop.run(load_case(None, ["scenario=large", "duration=5", f"link={link}", *more]))


def test_released_device_is_latched_or_comes_back_after_good_setpoints() -> None:
    latched, back = gap([]), gap(["watchdog.good=30"])
    assert (latched.devices["released"][latched.time_s > 2.8, 0] == 1.0).all()
    assert (latched.devices["reference"][latched.time_s > 4.0, 0] == 0.0).all()
    (row,) = summarise(back).releases
    assert row.device == "sssc"
    assert row.time_s == pytest.approx(2.5 - 1 / RATE + 0.2, abs=1 / RATE)
    assert row.rearmed_s == pytest.approx(3.0 + 30 / RATE, abs=0.5 / RATE)  # with the 30th that came
    again = back.devices["reference"][back.time_s > 4.0, 0]
    assert np.abs(again).max() > 0.001


def test_wall_clock_releases_who_heard_nothing_and_only_they_are_re_armed() -> None:
    watch = watchdog.initial_watch(3)
    latest = watchdog.initial_clock_state(3)
    watch["accepted_ns"] = [NOT_YET, 5, 6]
    assert watchdog.late_by_clock(watch, latest, 10.0, 0.2) == []
    assert watch["released"].tolist() == [0, 0, 0]
    watch["accepted_ns"][2] = 7
    assert watchdog.late_by_clock(watch, latest, 10.3, 0.2) == [1]  # wall time: it has heard nothing for 0.3 s
    watchdog.let_go(watch, 1)
    assert watch["released"].tolist() == [0, 1, 0]
    watchdog.rearm(watch, 100)
    assert watch["released"].tolist() == [0, 0, 0]
    assert watch["accepted_ns"].tolist() == [NOT_YET, 100, 7]


def test_table_says_when_a_device_was_released_and_why() -> None:
    text = table([("first", summarise(gap([]))), ("other", summarise(gap(["watchdog=off"])))])
    (line,) = [line for line in text.splitlines() if line.startswith("sssc released")]
    assert line.split()[2:] == ["at", "2.70", "s:", "no", "setpoint", "for", "0.2", "s", "-"]


def test_overtaken_setpoints_are_refused_and_told() -> None:
    link = json.dumps({"down": [{"model": "normal", "mean": 0.1, "std": 0.03}]})
    record = loop.run(load_case(None, [f"link={link}", "duration=5"]))
    counts = summarise(record).refused_setpoints["sssc"]
    assert counts["order"] > 10
    assert counts["value"] == counts["stamp"] == 0
    assert f"{counts['order']} by order" in table([("run", summarise(record))])


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["watchdog.timeout=0"], "watchdog.timeout: 0"),
        (["watchdog.patience=1"], "patience"),
        (["watchdog=asleep"], "watchdog"),
        (["system.devices.0.hold=0.3"], "'hold' given; allowed: 'watchdog.timeout'"),
    ],
)
def test_invalid_watchdog_is_refused(sets: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_case(None, sets)


def test_off_may_be_opened_by_a_field() -> None:
    run = load_case("two_area_small", ["watchdog.timeout=0.5"]).run
    assert run.watchdog == Watchdog(timeout=0.5)
    assert load_case("two_area_small", []).run.watchdog is None


def test_age_is_by_the_device_s_own_time_not_by_the_setpoint_s() -> None:
    """One that says it arrived long ago, on data of then, is too old."""
    built = build_plant(load_case(None, []))
    old = setpoint(0, value=0.05)
    advance(built.plant, built.state, 5000 * MS, 5000 * MS + TICK, old, 1, workspace(built.plant, built.state))
    assert built.state.watch["refused_stamp"].tolist() == [1]
    assert built.state.target.tolist() == [0.0]


@pytest.fixture(scope="module")
def shipped() -> Built:
    return build_plant(load_case(None, []))


@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_whatever_comes_the_reference_keeps_its_limits_and_is_zero_in_time(shipped: Built, data: st.DataObject) -> None:
    """Random setpoints over half a second, forged ones among them, then silence: zero within time-out and ramp."""
    plant, state = shipped.plant, copy(shipped.state)
    work, row = workspace(plant, state), plant.devices[0]
    numbers = st.one_of(st.floats(allow_nan=True, allow_infinity=True), st.floats(-0.1, 0.1))
    times = st.one_of(st.integers(-(2**62), 2**62), st.integers(0, 600 * MS))
    received = 0
    for k in range(30):
        start, end = tick_ns(k, RATE), tick_ns(k + 1, RATE)
        come = np.zeros(data.draw(st.integers(0, 3)), SETPOINT)
        for entry in come:
            entry["measured_ns"], entry["issued_ns"] = data.draw(times), data.draw(times)
            entry["value"], entry["effective_ns"] = (
                data.draw(numbers),
                data.draw(st.one_of(st.integers(start, end), times)),
            )
        come = np.sort(come, order="effective_ns")
        received += len(come)
        advance(plant, state, start, end, come, len(come), work)
        assert abs(state.reference[0]) <= row["setpoint_max"]
        assert np.isfinite(state.x).all()
    watch = state.watch[0]
    assert watch["refused_value"] + watch["refused_stamp"] + watch["refused_order"] <= received
    slow = 0.2 + row["setpoint_max"] / row["watchdog"]["release_rate"]
    nothing = np.zeros(0, SETPOINT)
    for k in range(30, 31 + int(np.ceil(RATE * slow))):
        advance(plant, state, tick_ns(k, RATE), tick_ns(k + 1, RATE), nothing, 0, work)
    assert state.reference[0] == 0.0
