"""What supervisors did: changes with their cause, silence, refusals and probes, of made records and of runs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis.latency import hops_ms, latency, left_out
from facts_damping.analysis.summary import summarise
from facts_damping.analysis.summary_table import supervision_rows, table
from facts_damping.analysis.supervision import (
    StateChange,
    SupervisorHistory,
    change_text,
    history_text,
    limits,
    supervision,
    tripped_texts,
)
from facts_damping.case.loading import load_case
from facts_damping.monitor_table import (
    ARMED,
    BY_OPERATOR,
    BY_SCHEDULE,
    CODES,
    COUNTED,
    DISARMED,
    FALLBACK,
    MONITORS,
    NO_CAUSE,
    PROBE_GAIN,
    PROBE_PHASE,
    PROBE_WEAK,
    SHADOW,
    TRIPPED,
    reason_of,
)
from facts_damping.signals import SUPERVISION
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record

SETTLED = ("supervision=standard", "arm_at=0.5")
WRONG_SIGN = "controllers.0.faults=[{kind: wrong_sign, start: 2}]"


def shadow_rows(ticks: int, **changes: Any) -> Any:
    """Rows of a supervisor in shadow that has found nothing."""
    shadow = np.zeros(ticks, SUPERVISION)
    shadow["tick"], shadow["state"], shadow["fraction"] = np.arange(ticks), SHADOW, 1.0
    shadow["cause"] = shadow["refused"] = NO_CAUSE
    for name in ("probe_gain", "probe_phase", "probe_coherence", "added_damping", "phase_margin", "gain_margin"):
        shadow[name] = np.nan
    for name, value in changes.items():
        shadow[name] = value
    return shadow


@pytest.fixture
def watched(swing_record: Callable[..., Record]) -> Callable[[Any], Any]:
    """What is told of the only supervisor of a record of 20 s, whose limits are the table's but for one."""

    def find(supervised: Any) -> SupervisorHistory:
        record = swing_record(supervision=supervised)
        record.configuration["supervision"] = {"monitors": {"harm": {"limit": 0.05}, "jitter": None}}
        (history,) = supervision(record, 0.5)
        return history

    return find


def test_changes_have_time_cause_value_and_the_run_s_limit(watched: Callable[[Any], Any]) -> None:
    supervised = shadow_rows(1200)
    supervised["state"][30:300], supervised["cause"][30:300] = ARMED, BY_SCHEDULE
    supervised["state"][300:480], supervised["cause"][300:480], supervised["values"][300, CODES["stale"]] = (
        FALLBACK,
        CODES["stale"],
        0.41,
    )
    supervised["state"][480:600], supervised["cause"][480:600] = ARMED, CODES["stale"]
    supervised["state"][600:900], supervised["cause"][600:900], supervised["values"][600, CODES["harm"]] = (
        TRIPPED,
        CODES["harm"],
        0.21,
    )
    supervised["state"][900:], supervised["cause"][900:] = DISARMED, BY_OPERATOR
    history = watched(supervised)
    assert [(row.time_s, row.state, row.cause) for row in history.changes] == [
        (0.5, "armed", "schedule"),
        (5.0, "fallback", "stale"),
        (8.0, "armed", "stale"),
        (10.0, "tripped", "harm"),
        (15.0, "disarmed", "operator"),
    ]
    assert [row.value for row in history.changes] == [None, 0.41, None, 0.21, None]
    assert (history.changes[1].limit, history.changes[1].unit) == (0.4, "s")
    assert history.changes[3].limit == 0.05
    assert history.fractions == pytest.approx(
        {"disarmed": 0.25, "shadow": 0.025, "armed": 0.325, "fallback": 0.15, "tripped": 0.25}
    )
    assert (history.controller, history.state, history.trips, history.probe) == (
        "controller_0_LLC",
        "disarmed",
        1,
        None,
    )
    assert history_text(history) == (
        "armed at 0.50 s; fallback at 5.00 s: stale 0.41 s, more than 0.4; armed again at 8.00 s: stale is over; "
        "tripped at 10.00 s: harm 0.21 1/s, more than 0.05; disarmed at 15.00 s: operator"
    )
    assert tripped_texts([history]) == [
        "controller_0_LLC was tripped at 10.00 s: harm 0.21 1/s, more than 0.05",
    ]


def test_supervisor_that_never_arms_says_so(watched: Callable[[Any], Any]) -> None:
    history = watched(shadow_rows(1200))
    assert (history.changes, history.state, tripped_texts([history])) == ([], "shadow", [])
    assert history_text(history) == "never armed, shadow to the end"


@pytest.mark.parametrize(
    ("cause", "values", "text"),
    [
        (PROBE_WEAK, {"probe_coherence": 0.4}, "probe: coherence 0.4, less than 0.5"),
        (PROBE_GAIN, {"probe_gain": 0.2}, "probe: gain 0.2, less than 0.333"),
        (PROBE_GAIN, {"probe_gain": 4.0}, "probe: gain 4, more than 3"),
        (PROBE_WEAK, {"probe_coherence": 0.9}, "probe: coherence"),  # told is another device's
        (PROBE_GAIN, {"probe_gain": 1.2}, "probe: gain"),
        (PROBE_PHASE, {"probe_phase": -math.pi / 2}, "probe: phase 90 deg, more than 60"),
        (CODES["frequency"], {"values": 3.5}, "frequency 3.5 Hz, more than 3"),
        (CODES["missing"], {"values": 0.160004}, "missing 0.160004 s, more than 0.16"),
        (CODES["missing"], {"values": np.nextafter(0.16, 1.0)}, "missing 0.16 s, the limit"),
        (CODES["range"], {"values": math.inf}, "range"),
    ],
)
def test_why_it_was_not_armed(watched: Callable[[Any], Any], cause: int, values: dict[str, float], text: str) -> None:
    supervised = shadow_rows(1200)
    for name, value in values.items():
        supervised[name][119] = value  # what was known when it was asked for
    supervised["refused"][120:] = cause
    history = watched(supervised)
    assert (len(history.refusals), history.refusals[0].time_s) == (1, 2.0)
    assert history_text(history).startswith(f"not armed at 2.00 s: {text}; never armed, shadow to the end")


def test_supervisor_that_fails_is_silent(watched: Callable[[Any], Any]) -> None:
    """Single ticks that are missing are not: devices wait for 0.2 s."""
    supervised = shadow_rows(1200)
    supervised["state"][60:] = ARMED
    left = np.delete(supervised, [*range(120, 180), 600, 601])[:-30]
    history = watched(left)
    assert [(row.time_s, row.state) for row in history.changes] == [
        (1.0, "armed"),
        (2.0, "silent"),
        (3.0, "armed"),
        (19.5, "silent"),
    ]
    assert history.state == "silent"
    assert sum(history.fractions.values()) == pytest.approx(len(left) / 1200)


def test_newest_probe(watched: Callable[[Any], Any]) -> None:
    supervised = shadow_rows(1200)
    supervised["probe_gain"][60:], supervised["probe_gain"][600:] = 2.0, 1.1
    supervised["probe_phase"][60:], supervised["probe_coherence"][60:] = 0.1, 0.9
    supervised["added_damping"][60:], supervised["phase_margin"][60:], supervised["gain_margin"][60:] = (
        0.2,
        math.pi / 3,
        0.25,
    )
    probe = watched(supervised).probe._asdict()
    assert probe == pytest.approx(
        {
            "gain": 1.1,
            "phase_deg": math.degrees(0.1),
            "coherence": 0.9,
            "added_damping_per_s": 0.2,
            "phase_margin_deg": 60.0,
            "delay_margin_ms": 1e3 / 3,  # of 0.5 Hz
            "gain_margin": 0.25,
        }
    )
    texts = dict(supervision_rows([[watched(supervised)], []]))
    assert texts["controller_0_LLC"] == ["never armed, shadow to the end", "-"]
    assert texts["controller_0_LLC probe"] == [
        (
            "1.10 times the model's response, +6 deg; coherence 0.90; adds 0.2 1/s of damping; "
            "phase margin 60 deg (333 ms); gain margin 0.25"
        ),
        "-",
    ]


def test_many_changes_are_counted(watched: Callable[[Any], Any]) -> None:
    supervised = shadow_rows(1200)
    supervised["state"] = np.where(np.arange(1200) // 60 % 2, ARMED, SHADOW)
    supervised["cause"][60:] = BY_OPERATOR
    text = history_text(watched(supervised))
    assert text.count(";") == 5
    assert text.startswith("armed at 1.00 s: operator; shadow at 2.00 s: operator; ")
    assert text.endswith("; 14 more changes; armed again at 19.00 s: operator")


def test_run_whose_controller_turns_its_sign_is_tripped_and_told() -> None:
    record = loop.run(load_case("two_area_small", [*SETTLED, "duration=8", WRONG_SIGN]))
    result: Any = summarise(record)
    (history,) = result.supervision
    assert (history.state, history.trips, history.changes[-1].cause) == ("tripped", 1, "harm")
    assert history.changes[-1].value > history.changes[-1].limit == 0.03
    assert history.changes[0].time_s == 0.5
    assert "tripped at 5.43 s: harm" in table([("it", result)])
    assert limits(record)["harm"] == 0.03


def test_without_a_supervisor_nothing_is_told(swing_record: Callable[..., Record]) -> None:
    result: Any = summarise(swing_record())
    assert result.supervision == []
    assert supervision_rows([result.supervision]) == []


@pytest.mark.parametrize("rate", [60, 50, 7])
def test_zeros_of_supervisors_have_no_latency(rate: int) -> None:
    """In shadow a supervisor speaks once a tick, of no measurement: only what a controller said counts."""
    sets = [*SETTLED, "duration=3", f"frame_rate={rate}", "link={up: [{model: constant, delay: 0.1}]}"]
    record = loop.run(load_case("two_area_small", sets))
    acting = record.applied[record.applied["effective_ns"] > 700_000_000]
    assert latency(record).mean == pytest.approx(100.0, abs=0.01)
    assert left_out(record) == 0
    assert len(acting) <= len(hops_ms(record)["whole"]["sssc"]) < len(record.applied)
    in_shadow = loop.run(load_case("two_area_small", ["supervision=standard", "duration=1"]))
    assert len(in_shadow.applied) > 0
    assert latency(in_shadow).mean is None


@pytest.mark.parametrize(
    ("cause", "value", "limit", "text"),
    [
        ("device", 1.0, 0.5, "1 device blocked or released"),
        ("device", 3.0, 2.5, "3 devices blocked or released"),
        ("status", 1.0, 0.5, "1 PMU of bad status"),
        ("non_finite", 2.0, 0.0, "2 outputs not finite"),
        ("harm", 0.21, 0.03, "harm 0.21 1/s, more than 0.03"),
    ],
)
def test_monitors_that_count_are_told_in_words(cause: str, value: float, limit: float, text: str) -> None:
    """The cause keeps its name, value, limit and unit for programs."""
    change = StateChange("tripped", 1.22, cause, value, limit, MONITORS[cause].unit)
    assert change_text(change) == f"tripped at 1.22 s: {text}"
    assert all(cause in MONITORS for cause in COUNTED)
    row = {"cause": CODES[cause], "refused": CODES[cause], "values": np.full(len(MONITORS), value)}
    thresholds: Any = {"limit": np.full(len(MONITORS), limit)}
    reason = reason_of(row, thresholds)
    if cause in COUNTED:
        assert reason == f"{text}; allowed: {int(limit) or 'none'}"
        remedy = "; re-arm released devices first" if cause == "device" else ""
        assert reason_of(row, thresholds, refused=True) == f"{reason}{remedy}"
    else:
        assert reason.endswith(": 0.21 1/s; allowed: 0.03")
