"""Whole runs over links: the presets' delays, traces from files, errors of one line, random links."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facts_damping.analysis.latency import frames_lost, latency
from facts_damping.case.delay_traces import of_record
from facts_damping.case.loading import load_case, make_case
from facts_damping.errors import InputError
from facts_damping.parameters.files import shipped
from facts_damping.simulation import loop
from tests.link.test_models import anything, waits

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.record import Record

# Shortest, mean and longest delay from measurement to device, s; standard deviation of a single one.
PRESETS: dict[str, tuple[float, float, float, float]] = {
    "ideal": (0.0, 0.0, 0.0, 0.0),
    "delay_100ms": (0.1, 0.1, 0.1, 0.0),
    "pdci": (0.069, 0.082, 0.15, 0.005 * math.sqrt(2.6)),
    "pdci_100ms": (0.087, 0.1, 0.168, 0.005 * math.sqrt(2.6)),
    "csg": (0.11, 0.11, 0.11, 0.0),
    "fibre": (0.1, 0.125, 0.15, 0.05 / math.sqrt(12.0)),
    "plc": (0.15, 0.25, 0.35, 0.2 / math.sqrt(12.0)),
    "satellite": (0.5, 0.6, 0.7, 0.2 / math.sqrt(12.0)),
}


def run(link: str | dict[str, Any], *more: str) -> Record:
    link_text = link if isinstance(link, str) else json.dumps(link)
    return loop.run(load_case(None, [f"link={link_text}", *more]))


def test_table_of_link_presets_is_complete() -> None:
    assert set(shipped("links")) == set(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_preset_has_the_delays_that_it_stands_for(name: str) -> None:
    """Without the stage that keeps order: it lets entries wait for slower ones before them."""
    shortest, mean, longest, deviation = PRESETS[name]
    link = load_case(None, [f"link={name}"]).link.model_dump()
    link["up"] = [stage for stage in link["up"] if stage["model"] != "in_order"]
    record = run(link, "duration=20", "controllers=[]")
    up = (record.delivered["arrival_ns"] - record.delivered["measured_ns"]) * 1e-9
    late = up + sum(stage.get("delay", 0.0) for stage in link["down"])
    assert len(late) > 4000
    assert shortest - 1e-9 <= late.min() <= late.max() <= longest + 1e-9
    assert abs(late.mean() - mean) <= 3.0 * deviation / math.sqrt(len(late)) + 1e-9


def test_loop_over_a_preset_reports_its_latency() -> None:
    """A setpoint rests on the newest frame of any PMU, so it is not older than entries are on average."""
    latencies = latency(run("pdci"))
    assert 69.0 <= float(latencies.mean or 0.0) <= 82.0
    assert float(latencies.max or 0.0) < 150.0


def test_lag_of_an_identifier_is_the_links_mean_delay() -> None:
    case = load_case(None, ["link=pdci", "controllers.0.name=HBsWC"])
    assert case.controllers[0].number("loop_delay") == pytest.approx(0.082)


def test_losses_are_counted() -> None:
    link = {"up": [{"model": "bernoulli", "loss": 0.1}]}
    record = run(link)
    n = record.frames.shape[0] * record.frames.shape[1]
    assert abs(frames_lost(record) / n - 0.1) < 3.0 * math.sqrt(0.09 / n)


def test_without_anything_delivered_the_devices_stay_at_rest() -> None:
    """Total loss is the run without control, and says so."""
    record = run({"up": [{"model": "bernoulli", "loss": 1.0}]}, "scenario=large")
    without = loop.run(load_case(None, ["scenario=large", "controllers=[]"]))
    assert len(record.delivered) == len(record.issued) == 0
    np.testing.assert_array_equal(record.frames, without.frames)


def test_seed_of_the_run_is_that_of_its_links() -> None:
    first, same, other = (run("plc", f"seed={seed}", "duration=3") for seed in (1, 1, 2))
    assert first.delivered.tobytes() == same.delivered.tobytes()
    assert first.delivered["arrival_ns"].tolist() != other.delivered["arrival_ns"].tolist()


def trace_run(path: Path, *more: str) -> Record:
    return run({"up": [{"model": "trace", "file": str(path)}]}, "controllers=[]", "duration=1", *more)


def test_table_of_delays_is_replayed(tmp_path: Path) -> None:
    path = tmp_path / "delays.csv"
    path.write_text("delay_s\n0.03\n\n0.01\n", encoding="utf-8")
    record = trace_run(path)
    entries = record.delivered[record.delivered["pmu"] == 0]
    late = {int(row["measured_ns"]): (row["arrival_ns"] - row["measured_ns"]) * 1e-9 for row in entries}
    delays = [late.get(int(time), math.nan) for time in record.time_ns[:6]]
    np.testing.assert_allclose(delays, [0.03, math.nan, 0.01] * 2)
    again = make_case(record.configuration, "stored")  # it holds the delays themselves
    assert loop.run(again).delivered.tobytes() == record.delivered.tobytes()


def test_controller_knows_the_mean_delay_of_what_it_waits_for() -> None:
    """Of the slowest of its PMUs and devices, in all and of the way down; what others wait for does not count."""
    up = [
        {"delay": 0.1, "channels": ["w13"]},  # G1, G3
        {"model": "uniform", "low": 0.0, "high": 0.2, "channels": ["TIE"]},
        {"model": "gamma", "delay": 0.01, "shape": 2.0, "scale": 0.01},
        {"delay": 9.0, "start": 1.0},
    ]
    link = {"up": up, "down": [{"delay": 0.2, "channels": ["sssc"]}, {"delay": 0.02, "channels": ["statcom"]}]}

    def known(signals: list[str], devices: list[str], link: dict[str, Any] = link) -> tuple[float, float]:
        row = {"name": "ANFTSC", "signals": signals, "devices": devices, "link": link}
        case = load_case(None, ["devices=[sssc, statcom]", f"controllers={json.dumps([row])}"])
        return case.controllers[0].number("loop_delay"), case.controllers[0].number("down_delay")

    assert known(["speed"], ["sssc"]) == pytest.approx((0.1 + 0.03 + 0.2, 0.2))
    assert known(["w12"], ["statcom"]) == pytest.approx((0.1 + 0.03 + 0.02, 0.02))
    assert known(["w34"], ["statcom"]) == pytest.approx((0.1 + 0.03 + 0.02, 0.02))
    assert known(["power"], ["statcom"]) == pytest.approx((0.1 + 0.03 + 0.02, 0.02))
    assert known(["speed", "power"], ["statcom", "sssc"]) == pytest.approx((0.33, 0.2))
    up.append({"delay": 0.3, "channels": ["G4"]})
    assert known(["w12"], ["sssc"]) == pytest.approx((0.33, 0.2))
    assert known(["w34"], ["sssc"]) == pytest.approx((0.63 - 0.1, 0.2))


def test_table_may_have_a_column_a_station(tmp_path: Path) -> None:
    path = tmp_path / "delays.csv"
    name = load_case(None).system.pmus[1].name
    path.write_text(f"{name}\n0.03\n", encoding="utf-8")
    entries = trace_run(path).delivered
    assert set((entries["arrival_ns"] - entries["measured_ns"])[entries["pmu"] == 1].tolist()) == {30_000_000}
    assert set((entries["arrival_ns"] - entries["measured_ns"])[entries["pmu"] != 1].tolist()) == {0}


def test_delays_of_a_record_replayed_are_those_of_the_record() -> None:
    """Delays and losses, up and down: the links of both runs deliver the same."""
    rough = {
        "up": [{"model": "uniform", "low": 0.0, "high": 0.2}, {"model": "bernoulli", "loss": 0.2}],
        "down": [{"model": "uniform", "low": 0.0, "high": 0.1}],
    }
    first = run(rough, "duration=5")
    traces = {way: [{"model": "trace", "delays": of_record(first, way)}] for way in ("up", "down")}
    second = run(traces, "duration=5")
    early = 4 * 60
    for name in ("delivered", "applied"):
        a, b = (getattr(record, name) for record in (first, second))
        assert a[a["tick"] < early].tobytes() == b[b["tick"] < early].tobytes()


BAD: list[tuple[Any, str]] = [
    ({"up": [{"model": "gama"}]}, "link.up.0.model: 'gama' given; allowed: 'constant', 'uniform'"),
    ({"up": [{"model": "uniform", "low": 2.0, "high": 1.0}]}, "link.up.0: low 2, high 1 given; allowed: low not above"),
    ({"up": [{"model": "uniform", "low": 2.0}]}, "link.up.0.high: missing"),
    ({"up": [{"delay": -1.0}]}, "link.up.0.delay: -1.0 given; allowed: greater than or equal to 0"),
    ({"up": [{"model": "bernoulli", "loss": 1.5}]}, "link.up.0.loss: 1.5 given; allowed: less than or equal to 1"),
    (
        {"up": [{"model": "bernoulli", "fraction": 0.5, "loss": 0.5}]},
        "link.up.0.fraction: 0.5 given; allowed for model bernoulli: stage, channels",
    ),
    ({"down": [{"model": "wait", "wait": 0.1}]}, "down.0.model: 'wait' given; allowed: up only"),
    ({"down": [{"model": "freeze", "measurement": "active_power"}]}, "down.0.measurement: given; allowed: up only"),
    ({"up": [{"channels": ["sssc"]}]}, "link.up.0.channels: 'sssc' given; allowed: "),
    ({"down": [{"channels": ["speed"]}]}, "link.down.0.channels: 'speed' given; allowed: sssc"),
    ({"up": [{"model": "trace"}]}, "link.up.0: a trace needs either `file` or `delays`"),
    ({"up": [{"model": "trace", "delays": []}]}, "an empty list given; allowed: at least one delay"),
    ({"up": [{"model": "trace", "delays": [0.1, 61.0]}]}, "delays: 61 given; allowed: 0 to 60"),
    ({"up": [{"model": "replay", "window": 2.0, "start": 1.0}]}, "start: 1 given; allowed: from 2 on"),
    ({"up": [{"model": "trace", "file": "nowhere.csv"}]}, "link: up.0.file: nowhere.csv: cannot be read"),
    ({"up": [{"model": "trace", "file": "nowhere"}]}, "allowed: a CSV file or a recording"),
]


@pytest.mark.parametrize(("link", "message"), BAD, ids=[message for _, message in BAD])
def test_bad_link_is_one_line(link: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as caught:
        load_case(None, [f"link={json.dumps(link)}"])
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no delays"),
        ("delay_s\n", "holds no delays"),
        ("delay_s\n0.1\nlate\n", "line 3, delay_s: 'late' given; allowed: a delay in s"),
        ("delay_s\n-0.1\n", "delays: -0.1 given; allowed: 0 to 60"),
    ],
)
def test_bad_table_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "delays.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as caught:
        trace_run(path)
    assert "\n" not in str(caught.value)


def on(channels: list[str], stages: st.SearchStrategy[dict[str, Any]]) -> st.SearchStrategy[dict[str, Any]]:
    """Stages for all channels, or for some."""
    some = st.lists(st.sampled_from(channels), min_size=1, unique=True).map(lambda names: {"channels": names})
    return st.builds(dict.__or__, stages, st.just({}) | some)


def any_link(device: str) -> st.SearchStrategy[dict[str, Any]]:
    """A link of two_area to a device."""
    up = st.lists(on(["w13", "speed", "G4", "TIE"], anything | waits), max_size=5)
    return st.fixed_dictionaries({"up": up, "down": st.lists(on([device], anything), max_size=3)})


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(link=any_link("sssc"), seed=st.integers(0, 2**31 - 1), name=st.sampled_from(["LLC", "HBsWC"]))
def test_any_link_gives_a_run(link: dict[str, Any], seed: int, name: str) -> None:
    """Nothing crashes, whatever comes late, twice, out of order or wrong; setpoints stay within the limits."""
    record = run(link, f"seed={seed}", "duration=3", f"controllers.0.name={name}")
    limit = load_case(None).system.device("sssc").setpoint_max
    for truth in ("rotor_angle", "speed_deviation"):
        assert np.isfinite(record.machines[truth][record.in_synchronism]).all()
    assert np.isfinite(record.issued["value"]).all()
    assert (np.abs(record.issued["value"]) <= limit).all()


@pytest.mark.parametrize("late_s", [0.0105, 0.05, 0.2])
def test_controller_is_not_woken_by_channels_that_it_does_not_use(late_s: float) -> None:
    """G3 and TIE are no part of `speed`: whether they come at once or late with the others is one and the same."""
    whole = run({"up": [{"delay": late_s}], "down": []}, "duration=5", "scenario=large")
    part = run({"up": [{"delay": late_s, "channels": ["speed"]}], "down": []}, "duration=5", "scenario=large")
    assert len(part.issued) > 250
    assert part.issued.tobytes() == whole.issued.tobytes()
    assert part.machines.tobytes() == whole.machines.tobytes()
