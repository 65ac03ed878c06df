"""Margins of the invariants: below zero exactly where what must hold does not, in words of their own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import ARMED, FALLBACK, TRIPPED
from facts_damping.simulation import loop
from facts_damping_studies.campaigns import invariants
from facts_damping_studies.campaigns.invariants import HARM, SETTLED_S, TOLERANCE, itae

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.record import Record

LIMIT = 0.1  # p.u., of the SSSC
# Values at the edge of what is allowed, one step of a number beyond, and far away.
VALUES = [0.0, TOLERANCE, np.nextafter(TOLERANCE, 1.0), LIMIT, LIMIT + TOLERANCE, LIMIT + 2e-9, -0.05, 5.0, np.nan]


@cache
def sound() -> tuple[Case, Record]:
    """A case that is tripped in time, and its record."""
    sets = ["duration=4", "scenario=large", "supervision=standard", "arm_at=0", "watchdog.timeout=0.1"]
    sets += ["controllers.0.faults=[{kind: nan, start: 2.0}]", "supervision.arming.trip_ramp=0.1"]
    case = load_case(None, sets)
    return case, loop.run(case)


def trip_tick(record: Record) -> int | None:
    """The first tick in which the controller is tripped."""
    statuses = record.supervision
    return min(statuses["tick"][statuses["state"] == TRIPPED].tolist(), default=None)


def says(case: Case, record: Record) -> dict[str, bool]:
    """Whether each invariant holds, one tick after the other, for one controller and one device."""
    device, rate, trip = case.system.device("sssc"), record.frame_rate, trip_tick(record)
    assert case.run.watchdog is not None
    reference, time_s = record.devices["reference"][:, 0].tolist(), record.time_s.tolist()
    passed, accepted = record.supervised, record.applied["effective_ns"].tolist()
    pairs = list(zip(reference, reference[1:], time_s, time_s[1:], strict=False))
    allowed = 0.1 + device.setpoint_max / case.run.watchdog.release_rate + 2.0 / rate
    since = [(t - max((at for at in accepted if at <= t), default=t)) / 1e9 for t in record.time_ns.tolist()]
    ramped = 0.0 if trip is None else trip / rate + 0.1
    statuses = record.supervision
    return {
        "within_limits": all(abs(u) <= device.setpoint_max + TOLERANCE for u in [*passed["value"], *reference])
        and all(abs(b - a) - device.rate_max * (t - s) <= TOLERANCE for a, b, s, t in pairs),
        "lets_go": not any(s > allowed and abs(u) > TOLERANCE for s, u in zip(since, reference, strict=True)),
        "zero_after_trip": trip is None
        or not (
            any(v != 0.0 and at > ramped * 1e9 + 2e9 / rate for v, at in passed[["value", "issued_ns"]].tolist())
            or any(s in (ARMED, FALLBACK) and k >= trip for s, k in statuses[["state", "tick"]].tolist())
        ),
        "device_at_zero": trip is None
        or not any(t > ramped + SETTLED_S and abs(u) > TOLERANCE for t, u in zip(time_s, reference, strict=True)),
        "cause_recorded": not any(s == TRIPPED and c < 0 for s, c in statuses[["state", "cause"]].tolist()),
    }


def test_invariants_hold_for_a_controller_that_is_tripped_in_time() -> None:
    case, record = sound()
    assert trip_tick(record) is not None
    holds = invariants.alone(case, record)
    assert holds == says(case, record) == dict.fromkeys(invariants.ALONE, True)


edits = st.tuples(
    st.sampled_from(["reference", "passed", "cause", "state", "cut"]), st.integers(0, 239), st.sampled_from(VALUES)
)


@settings(deadline=None, max_examples=60)
@example([("passed", 50, 0.2)])
@example([("reference", 239, TOLERANCE)])
@example([("reference", 239, np.nextafter(TOLERANCE, 1.0))])
@example([("passed", 239, 1e-6)])
@example([("cause", 200, 0.0)])
@example([("state", 239, 0.0)])
@example([("cut", 60, 0.0), ("reference", 90, 0.01)])
@given(st.lists(edits, min_size=1, max_size=3))
def test_margin_is_below_zero_where_what_must_hold_does_not(changes: list[tuple[str, int, float]]) -> None:
    case, record = sound()
    statuses, passed, devices = (np.copy(part) for part in (record.supervision, record.supervised, record.devices))
    applied = record.applied
    for what, tick, value in changes:
        match what:
            case "reference":
                devices["reference"][tick] = value
            case "passed":
                passed["value"][passed["tick"] == tick] = value
            case "cause":
                statuses["cause"][statuses["tick"] == tick] = -1
            case "state":
                statuses["state"][statuses["tick"] == tick] = ARMED
            case "cut":
                applied = applied[applied["tick"] < tick]
    changed = replace(record, supervision=statuses, supervised=passed, devices=devices, applied=applied)
    margins: dict[str, Any] = {name: rule.margin(case, changed) for name, rule in invariants.ALONE.items()}
    assert {name: margin >= 0.0 for name, margin in margins.items()} == says(case, changed)
    assert invariants.alone(case, changed) == says(case, changed)


@settings(deadline=None, max_examples=20)
@given(st.floats(0.5, 2.0) | st.just(HARM), st.none() | st.integers(100, 239), st.booleans())
def test_harm_is_an_index_above_that_without_control_or_a_lost_synchronism(
    factor: float, lost: int | None, free_lost: bool
) -> None:
    _, free = sound()
    machines, sizes = np.copy(free.machines), np.ones(len(free.time_ns), bool)
    machines["speed_deviation"] *= factor
    if lost is not None:
        sizes[lost:] = False
    changed = replace(free, machines=machines, in_synchronism=sizes)
    if free_lost:
        free = replace(free, in_synchronism=np.arange(240) < 239)
    figures, index = invariants.beside(changed, free), itae(changed)
    keeps, harmless = lost is None, index is not None and index <= HARM * (itae(free) or 0.0)
    assert figures.keeps_synchronism == (None if free_lost else keeps)
    assert figures.does_no_harm == (None if free_lost else harmless)
    for name, rule in invariants.BESIDE.items():
        assert figures.invariants[name] == invariants.holds(rule.margin(changed, free))
