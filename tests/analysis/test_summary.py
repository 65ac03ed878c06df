"""The summary of a record, its table, its pictures."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.image import imread

from facts_damping.analysis import summarise, table
from facts_damping.analysis.measures import event_times, speed_differences
from facts_damping.analysis.plotting.plots import plot_comparison
from facts_damping.analysis.summary import as_json
from facts_damping.analysis.supervision import StateChange, SupervisorHistory, history_text
from facts_damping.errors import InputError
from facts_damping.findings import findings
from facts_damping.monitor_table import STATES
from facts_damping.output.tables import WIDEST
from facts_damping.signals import CHANNELS, DEVICE_TRUTH
from facts_damping_views.analysis.details import details, lines

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.analysis.summary import Summary
    from facts_damping.record import Record

KEYS = {
    "run",
    "stable",
    "damped",
    "duration_s",
    "indices",
    "roughness",
    "settling_time_s",
    "max_injected_voltage_pu",
    "modes",
    "latency_ms",
    "frames_lost",
}
WEIGHTS = {"local": {"w12": {"G1": 1.0, "G2": -1.0}}, "interarea": {}}


def test_damped_run(swing_record: Callable[..., Record]) -> None:
    summary: Any = summarise(swing_record())
    content = as_json(summary)
    assert set(content) >= KEYS
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert summary.run == {"system": "pair", "controllers": []}
    assert summary.stable is summary.damped is True
    assert summary.duration_s == 20.0
    assert summary.latency_ms.p99 == 120.0
    assert summary.frames_lost == 0
    assert summary.max_injected_voltage_pu == pytest.approx(0.04 * np.exp(-0.15), rel=0.01)
    (mode,) = summary.modes
    assert mode.frequency_hz == pytest.approx(0.5, rel=1e-6)
    assert mode.damping_ratio == pytest.approx(0.3 / np.hypot(0.3, np.pi), rel=1e-6)
    assert summary.indices["ITAE"] > summary.indices_since_event["ITAE"]
    assert summary.indices["IAE"] == pytest.approx(summary.indices_since_event["IAE"])


def test_growing_run(swing_record: Callable[..., Record]) -> None:
    summary: Any = summarise(swing_record(damping=-0.1))
    assert summary.stable is True
    assert summary.damped is False
    assert summary.settling_time_s is None


def verdict_line(record: Record, summary: Summary) -> str:
    record.configuration["link"] = {"name": "ideal"}  # for the title
    return findings(record, summary, None)[1]


@pytest.mark.parametrize("growth", [0.02, 0.1, 0.3])
@pytest.mark.parametrize("decay", [0.05, 0.3])
def test_growing_run_is_told_by_its_growing_mode(
    swing_record: Callable[..., Record], growth: float, decay: float
) -> None:
    """A strong 1.1 Hz mode decays, a weak one of 0.5 Hz grows; and the reverse, where the strongest one is growing."""
    record = swing_record()
    t = np.maximum(record.time_s - 1.0, 0.0)
    strong, weak = (1e-3 * np.exp(rate * t) * np.sin(2 * np.pi * f * t) for rate, f in ((-decay, 1.1), (growth, 0.5)))
    for size in (0.05, 2.0):
        record.frames[:, 0, 2], record.frames[:, 1, 2] = strong + size * weak, -strong - size * weak
        summary = summarise(record)
        line = verdict_line(record, summary)
        if summary.verdict == "growing":
            assert summary.deciding_mode is not None
            assert summary.deciding_mode.growth_per_s == pytest.approx(growth, rel=0.05)
            assert re.fullmatch(r"growing; damping ratio -\d+\.\d % at 0.50 Hz", line)
        elif summary.verdict == "damped":
            assert line.startswith("damped; damping ratio ")
            assert "-" not in line
        else:
            assert line.startswith(f"{summary.verdict}: ")
    assert summary.verdict == "growing"


def test_growth_without_a_mode_that_grows_is_told_by_its_rate(swing_record: Callable[..., Record]) -> None:
    record = swing_record(damping=-0.1)
    summary = summarise(record)
    known = replace(summary, modes=[mode._replace(damping_ratio=0.05) for mode in summary.modes])
    assert verdict_line(record, known) == "growing: it grows by 0.1 1/s in w12"


def test_unstable_run(swing_record: Callable[..., Record]) -> None:
    lost = np.ones(1200, np.bool_)
    lost[-1] = False
    summary: Any = summarise(swing_record(in_synchronism=lost))
    assert summary.stable is summary.damped is False
    assert summary.indices is None
    assert not summary.modes
    json.dumps(as_json(summary), allow_nan=False)


def test_single_tick(swing_record: Callable[..., Record]) -> None:
    summary: Any = summarise(swing_record(7, configuration={"measures": WEIGHTS}, events=[]))
    json.dumps(as_json(summary), allow_nan=False)


def test_weights_given_directly(swing_record: Callable[..., Record]) -> None:
    inline = speed_differences(swing_record())["w12"]
    direct = speed_differences(swing_record(configuration={"measures": WEIGHTS}))["w12"]
    assert np.array_equal(inline, direct)
    assert summarise(swing_record(configuration={}), {"w12": inline}).indices is not None


@pytest.mark.parametrize(
    ("configuration", "reason"),
    [
        ({}, "measures: none given"),
        ({"measures": {"local": {"w19": {"G9": 1.0}}}}, "measures.w19: no PMU 'G9'; allowed: G1, G2, TIE"),
    ],
)
def test_measures_that_do_not_fit(
    swing_record: Callable[..., Record], configuration: dict[str, object], reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        summarise(swing_record(configuration=configuration))


def test_event_times(swing_record: Callable[..., Record]) -> None:
    assert event_times(swing_record()) == [1.0]
    events = [{"time": 2.0, "kind": "fault", "duration": 0.1}, {"time": 99.0, "kind": "clear"}]
    assert event_times(swing_record(configuration={"events": events}, events=[])) == [2.0, 2.1]


def test_table(swing_record: Callable[..., Record]) -> None:
    lost = np.zeros(1200, np.bool_)
    lines = table(
        [("calm", summarise(swing_record())), ("lost", summarise(swing_record(in_synchronism=lost)))]
    ).splitlines()
    assert lines[0].split() == ["calm", "lost"]
    assert lines[2].split() == ["in", "synchronism", "yes", "no"]
    assert any(line.startswith("ITAE") and line.endswith(" -") for line in lines)


def test_tables_fit_a_terminal_and_lose_nothing(swing_record: Callable[..., Record]) -> None:
    """Titles of 90 characters, and a supervisor with a long history, of one run and of three."""
    changes = [StateChange(state, 1.0, "growing", 0.22, 0.15, "1/s") for state in STATES]
    history = SupervisorHistory("controller_0_LLC_tuned", "tripped", {}, changes, 1, [], None)
    record = swing_record()
    summary = replace(summarise(record), supervision=[history])
    names = [f"run {i} of {'a name that is as long as a title of a run, ' * 2}" for i in range(3)]
    for count in (1, 3):
        shown = [*table([(name, summary) for name in names[:count]]).splitlines()]
        parts = [details(record)._replace(improvement_percent={"ITAE": 1.0})] * count
        shown += [line for text in lines(names[:count], [summary] * count, parts, 0) for line in text.splitlines()]
        assert max(map(len, shown)) <= WIDEST
        words = Counter(" ".join(shown).split())
        wanted = Counter(" ".join([*names[:count], *[history_text(history)] * count]).split())
        assert wanted <= words
    first = table([("", summary)]).splitlines()[0]
    assert first.split() == ["in", "synchronism", "yes"]


def test_pictures(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    stems = ("speeds", "differences", "tie_power", "injected_voltage", "indices", "latency")  # the voltage stands still
    names = [f"{stem}.png" for stem in stems]
    paths = plot_comparison([("", swing_record())], tmp_path)
    assert [path.name for path in paths] == names
    several = [("a", swing_record()), ("b", swing_record(600, damping=-0.1))]
    assert [path.name for path in plot_comparison(several, tmp_path)] == names
    for path in paths:
        picture = imread(path)
        assert picture.shape[1] > 1000
        assert (picture[..., :3] < 0.5).any()


def test_empty_pictures_are_left_out(tmp_path: Path, swing_record: Callable[..., Record]) -> None:
    record = swing_record(configuration={}, device_names=[], devices=np.zeros((1200, 0), DEVICE_TRUTH))
    stems = ["speeds", "tie_power", "latency"]
    assert [path.stem for path in plot_comparison([("", record)], tmp_path)] == stems
    with pytest.raises(InputError, match="no record given"):
        plot_comparison([], tmp_path)


def test_why_a_run_was_unstable(swing_record: Callable[..., Record]) -> None:
    assert summarise(swing_record()).instability is None
    ends = np.ones(1200, np.bool_)
    ends[-1] = False
    apart, collapsed = (swing_record(in_synchronism=ends) for _ in range(2))
    collapsed.machines["terminal_voltage"][-1] = np.nan
    assert summarise(apart).instability == "loss of synchronism"
    assert summarise(collapsed).instability == "voltage collapse: the network equations have no solution"
    assert "voltage collapse" in table([("x", summarise(collapsed))])


def test_without_measures_each_machine_counts_against_the_first(swing_record: Callable[..., Record]) -> None:
    machines = [{"name": name, "machine": name} for name in ("G1", "G2")]
    system = {"pmus": [*machines, {"name": "TIE", "bus": "B8"}], "measures": {"local": [], "interarea": []}}
    record = swing_record(configuration={"system": system})
    speeds = record.frames[:, :2, list(CHANNELS).index("speed_deviation")]
    np.testing.assert_array_equal(speed_differences(record)["G1-G2"], speeds[:, 0] - speeds[:, 1])
    at_infinite_bus = swing_record(configuration={"system": {**system, "infinite_buses": [{"name": "GRID"}]}})
    np.testing.assert_array_equal(speed_differences(at_infinite_bus)["G2"], speeds[:, 1])
