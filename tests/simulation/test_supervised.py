"""Supervised runs in process: the same bits tick by tick, changed under way, and replayed; faults of controllers."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.monitor_table import STATES, cause_name
from facts_damping.parameters.faults import ControllerFault
from facts_damping.record import RunChange
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.loop import build_loop, record, run_loop
from facts_damping.simulation.replaying import replay
from facts_damping.simulation.stepping import Stepper
from tests.two_devices import decentralised

if TYPE_CHECKING:
    from facts_damping.record import Record

TABLES = ("delivered", "issued", "supervised", "supervision", "applied", "devices", "machines", "estimates", "learning")
ON = ["supervision=standard", "arm_at=0.5", "scenario=large", "duration=5"]
OUTAGE = [{"delay": 0.02}, {"model": "bernoulli", "loss": 1.0, "start": 2.0, "duration": 0.6}]
LOCAL = {"name": "LLC", "signals": ["power_rate"], "parameters": {"gain": 0.05}, "fallback_of": 0}
FALLBACK = [
    f"link={json.dumps({'up': OUTAGE})}",
    "supervision.arming.recovery=1",
    f"controllers={json.dumps([{'name': 'LLC'}, {**LOCAL, 'link': 'csg'}])}",
]
FAULTS = [{"kind": kind, "start": 1.5, "duration": 0.4} for kind in ("dead", "gain")]
RUNS = {
    "lead-lag, late": ["link=pdci"],
    "fallback by its own link": FALLBACK,
    "indirect": ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "link=delay_100ms"],
    "two of several inputs": [*decentralised("HBsWC", "indirect"), "link=csg"],
    "authority": ["supervision.authority={fraction: 0.5, rate: 1.0, energy: 0.4}", "link=pdci"],
    "probe": ["supervision.probe={start: 1.2, cycles: 2}", "arm_at=4.5", "scenario=[]"],
    "faults": [
        *("controllers.0.name=HBsWC", "controllers.0.scheme=direct", f"controllers.0.faults={json.dumps(FAULTS)}"),
        "supervision.monitors.silent.follows=warn",
    ],
    "supervisor that dies": ["supervision.fault={kind: dead, start: 1.5, duration: 0.3}", "watchdog=off"],
    "supervisor that hangs": ["supervision.fault={kind: hung, start: 1.5, duration: 0.3}", "watchdog=off"],
}


def assert_same(first: Record, other: Record) -> None:
    for name in TABLES:
        assert getattr(first, name).tobytes() == getattr(other, name).tobytes(), name


def states(run_record: Record, controller: int = 0) -> list[tuple[str, str]]:
    """States one after the other, and why."""
    rows_of_controller = run_record.supervision[run_record.supervision["controller"] == controller]
    states_told = [(STATES[row["state"]], cause_name(int(row["cause"]))) for row in rows_of_controller]
    return [state for k, state in enumerate(states_told) if k == 0 or state != states_told[k - 1]]


@cache
def run(*sets: str) -> Record:
    return loop.run(load_case(None, list(sets)))


@pytest.mark.parametrize("name", RUNS)
def test_same_bits_tick_by_tick_and_in_a_replay(name: str) -> None:
    case, whole = load_case(None, [*ON, *RUNS[name]]), run(*ON, *RUNS[name])
    assert np.any(whole.supervised["value"] != 0.0)
    assert_same(rerun(case, []), whole)
    built = build_loop(case)
    stepper = Stepper(case, built)
    while stepper.step(None):
        pass
    assert_same(record(case, built), whole)
    again = replay.case_of(whole, "it", None, [])
    part = replay.fitted(whole, again)
    played = replay.play(again, part)
    assert replay.first_difference(part, played.issued) is None
    assert replay.first_estimate(part, played.estimates) is None
    assert replay.first_supervised(part, played) is None


def test_supervised_runs_go_through_the_expected_states() -> None:
    by_name = {name: states(run(*ON, *RUNS[name])) for name in RUNS}
    armed = ("armed", "schedule")
    assert by_name["fallback by its own link"][1:] == [armed, ("fallback", "missing"), ("armed", "missing")]
    assert by_name["probe"] == [("shadow", ""), armed]
    assert by_name["supervisor that dies"] == [("shadow", ""), armed, ("shadow", "")]
    assert by_name["supervisor that hangs"][:2] == [("shadow", ""), armed]


@pytest.mark.parametrize(
    "sets",
    [
        ["link=pdci"],
        ["controllers.0.name=HBsWC", "link=csg"],
        ["controllers.0.name=ANFTSC", "controllers.0.scheme=direct"],
        [*decentralised("ANFTSC", "direct"), "link=delay_100ms"],
        ["measurement=p_class", "controllers.0.signals=[frequency]", "link=fibre"],
    ],
    ids=str,
)
def test_run_that_is_armed_from_the_start_is_the_one_without_supervisors(sets: list[str]) -> None:
    common = ["scenario=large", "duration=4", *sets]
    alone = loop.run(load_case(None, common))
    watched = ["supervision=standard", "supervision.arming.ramp=0", "arm_at=0", "supervision.monitors.reversals=off"]
    supervised = loop.run(load_case(None, [*common, *watched]))
    assert {state for state, _ in states(supervised)} == {"armed"}
    for name in ("issued", "applied", "frames", "machines", "devices", "estimates", "learning"):
        assert getattr(alone, name).tobytes() == getattr(supervised, name).tobytes(), name
    assert len(alone.supervision) == 0


def test_setpoints_are_the_controller_s_once_the_ramp_is_over() -> None:
    run_record = loop.run(load_case(None, [*ON, "link=pdci", "supervision.monitors.reversals=off"]))
    said, issued = (table[table["tick"] > 0.5 * 60 + 60] for table in (run_record.supervised, run_record.issued))
    assert len(said) > 200
    assert said.tobytes() == issued.tobytes()


def test_in_shadow_the_controller_works_and_nothing_acts() -> None:
    run_record = loop.run(load_case(None, ["supervision=standard", "scenario=large", "duration=4"]))
    none = loop.run(load_case(None, ["scenario=large", "duration=4", "controllers=[]"]))
    assert np.abs(run_record.issued["value"]).max() > 0.05
    assert np.all(run_record.supervised["value"] == 0.0)
    assert np.allclose(
        run_record.frames, none.frames, rtol=0.0, atol=1e-7, equal_nan=True
    )  # but for steps that end with a setpoint
    assert {tuple(row) for row in run_record.supervision[["state", "cause"]].tolist()} == {(1, -1)}


def ask(tick: int, what: str, index: int = 0) -> RunChange:
    return RunChange(tick, "/n", "supervisor", index, what, "", None)


def test_operator_requests_under_way_are_replayed() -> None:
    case = load_case(None, ["supervision=standard", "scenario=large", "duration=5", "link=csg"])
    asked = [ask(30, "arm"), ask(120, "disarm"), ask(180, "arm"), ask(181, "reset"), ask(200, "arm")]
    run_record = rerun(case, asked)
    assert states(run_record) == [
        ("shadow", ""),
        ("armed", "operator"),
        ("disarmed", "operator"),
        ("shadow", "operator"),
        ("armed", "operator"),
    ]
    ticks = [
        int(row["tick"])
        for before, row in zip(run_record.supervision, run_record.supervision[1:], strict=False)
        if row["state"] != before["state"]
    ]
    assert ticks == [30, 120, 181, 200]
    part = replay.fitted(run_record, case)
    assert replay.first_supervised(part, replay.play(case, part)) is None
    forgotten = replay.fitted(rerun(case, []), case)
    assert replay.first_supervised(part, replay.play(case, forgotten)) == 30


FREE = ["scenario=large", "duration=4", "controllers.0.name=HBsWC", "controllers.0.scheme=direct", "watchdog=off"]


def faulty(kind: str, **more: Any) -> tuple[Record, Record]:
    """A run with a fault from 2 to 2.5 s, and without; nothing supervised."""
    fault = {"kind": kind, "start": 2.0, "duration": 0.5, **more}
    return loop.run(load_case(None, [*FREE, f"controllers.0.faults=[{json.dumps(fault)}]"])), run(*FREE)


def between(run_record: Record, first: int = 120, end: int = 150) -> Any:
    rows = run_record.issued
    return rows["value"][(rows["tick"] >= first) & (rows["tick"] < end)]


KINDS = ControllerFault.model_json_schema()["properties"]["kind"]["enum"]


@pytest.mark.parametrize("kind", KINDS)
def test_fault_does_what_it_is_said_to_do_while_it_lasts(kind: str) -> None:
    run_record, sound = faulty(kind)
    limit = load_case(None, FREE).system.device("sssc").setpoint_max
    assert between(run_record, 0, 120).tobytes() == between(sound, 0, 120).tobytes()
    wrong, right = between(run_record), between(sound)
    if kind in ("hung", "dead"):
        assert len(wrong) == 0
        assert len(between(run_record, 150, 240)) == 90
        return
    assert len(wrong) == len(right) == 30
    assert np.all(np.isnan(wrong)) if kind == "nan" else np.all(np.abs(wrong) <= limit)
    if kind == "wrong_sign":
        assert wrong[0] == -right[0] != 0.0
    elif kind == "gain":
        assert wrong[0] == np.clip(10.0 * right[0], -limit, limit)
    elif kind == "stuck":
        assert np.all(wrong == between(sound, 119, 120)[0])
    elif kind == "random":
        assert len(set(wrong.tolist())) > 20
        assert 0.3 * limit < np.std(wrong) < limit
        assert wrong.tobytes() == between(faulty(kind)[0]).tobytes()
    elif kind == "bang_bang":
        assert np.all(np.diff(wrong) == np.where(np.arange(29) % 2, -2.0, 2.0) * limit)
    elif kind == "weights":
        assert not np.array_equal(wrong, right)
        norms = run_record.learning["lyapunov"]
        assert np.isfinite(norms).all()


def test_sizes_are_those_given() -> None:
    run_record, sound = faulty("gain", size=-0.5)
    assert between(run_record)[0] == -0.5 * between(sound)[0]
    small, _ = faulty("weights", size=1e-6)
    large, _ = faulty("weights", size=1.0)
    apart = [np.abs(between(record_of_size)[0] - between(sound)[0]) for record_of_size in (small, large)]
    assert 0.0 < apart[0] < 1e-4 < apart[1]


def test_dead_controller_begins_again_knowing_nothing_and_a_hung_one_goes_on() -> None:
    """What a network has learnt by then: nothing, or what it had when it hung."""
    for kind in ("dead", "hung"):
        fault = {"kind": kind, "start": 2.0, "duration": 0.5}
        case = load_case(None, [*FREE, f"controllers.0.faults=[{json.dumps(fault)}]"])
        built = build_loop(case)
        fresh = built.control.bank_state.learner.theta[0].copy()
        stepper, thetas = Stepper(case, built), {}
        while stepper.step(None):
            thetas[stepper.tick] = built.control.bank_state.learner.theta[0].copy()
        assert not np.array_equal(thetas[119], fresh)
        expected = fresh if kind == "dead" else thetas[120]
        moved = [float(np.abs(thetas[k] - expected).max()) for k in (149, 151)]
        assert moved[1] < 0.05 * float(np.abs(thetas[119] - fresh).max()) or moved[1] < 1e-2
        other = build_loop(case)
        run_loop(other)
        assert record(case, other).issued.tobytes() == record(case, built).issued.tobytes()
