"""Supervisors as nodes: the bits of the in-process run, services and what they refuse, and what becomes of the dead."""

from __future__ import annotations

import json
import os
import signal
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from facts_damping_msgs.msg import SupervisorState
from rcl_interfaces.msg import Log
from rclpy.qos import qos_profile_rosout_default
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.monitor_table import MONITORS, STATES, cause_name
from facts_damping.nodes.launching import graph
from facts_damping.nodes.launching.starting import Parts
from facts_damping.parameters.security import add_key
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.replaying import replay
from tests.nodes.graphs import (
    LOADED_S,
    PATIENCE_S,
    assert_named,
    assert_same,
    payloads,
    quiet,
    run_graph,
    somebody,
    step,
    ticks,
    wait_until,
)
from tests.nodes.test_joining import Graph

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.record import Record

pytestmark = pytest.mark.usefixtures("loopback")

OUTAGE = [{"delay": 0.02}, {"model": "bernoulli", "loss": 1.0, "start": 2.0, "duration": 0.6}]
LOCAL = {"name": "LLC", "signals": ["power_rate"], "parameters": {"gain": 0.05}, "fallback_of": 0}
ON = ["supervision=standard", "arm_at=0.5", "scenario=large", "duration=4"]
FALLBACK = [f"controllers={json.dumps([{'name': 'LLC'}, {**LOCAL, 'link': 'csg'}])}", "supervision.arming.recovery=1"]
FAULTS = [{"kind": "weights", "start": 1.5}, {"kind": "dead", "start": 2.0, "duration": 0.3}]
NETWORKS: list[dict[str, object]] = [
    {
        "name": "HBsWC",
        "scheme": "indirect",
        "devices": ["statcom"],
        "signals": ["speed", "power"],
        "namespace": "area_1",
    },
    {"name": "ANFTSC", "scheme": "direct", "devices": ["sssc"], "link": "csg", "namespace": "tie", "faults": FAULTS},
]
GRAPHS = {
    "fallback by a link of its own": [
        *FALLBACK,
        f"link={json.dumps({'up': OUTAGE})}",
        "measurement.pmus={G2: {clock: {offset: -0.002}}}",  # whose first frame is of before the run
    ],
    "two networks in namespaces": [
        f"controllers={json.dumps(NETWORKS)}",
        "devices=[sssc, statcom]",
        "link=delay_100ms",
    ],
}


def states(record: Record, controller: int = 0) -> list[tuple[str, str]]:
    """States one after the other, and why."""
    rows_of_controller = record.supervision[record.supervision["controller"] == controller]
    rows = [(STATES[row["state"]], cause_name(int(row["cause"]))) for row in rows_of_controller]
    return [row for k, row in enumerate(rows) if k == 0 or row != rows[k - 1]]


@pytest.mark.parametrize("name", GRAPHS)
def test_supervised_graph_is_the_in_process_run_and_its_replay_to_the_bit(tmp_path: Path, name: str) -> None:
    """Signed in one of them; replayed in process and by nodes."""
    sets = [*ON, *GRAPHS[name]]
    if "networks" in name:
        add_key(tmp_path / "keys.yaml")
        sets.append(f"security.keys={tmp_path / 'keys.yaml'}")
    case = load_case(None, sets)
    recorded = run_graph(tmp_path / "it", sets)
    assert_same(recorded, loop.run(case))
    assert np.any(recorded.supervised["value"] != 0.0)
    if "fallback" in name:
        assert states(recorded)[2:] == [("fallback", "missing"), ("armed", "missing")]
    mine = replay.case_of(recorded, "it", None, [])
    part = replay.fitted(recorded, mine)
    played = replay.play(mine, part)
    assert replay.first_difference(part, played.issued) is None
    assert replay.first_supervised(part, played) is None
    bag = tmp_path / "it" / "recording"
    graph.run(mine, "lockstep", tmp_path / "again", quiet, LOADED_S, parts=Parts(replayed=bag))
    again = load(tmp_path / "again" / "recording")
    for table in ("issued", "supervised", "supervision", "estimates", "learning"):
        assert getattr(again, table).tobytes() == getattr(recorded, table).tobytes(), table


@pytest.mark.parametrize(
    ("node", "number", "expected"),
    [
        ("supervisor_0_LLC", signal.SIGKILL, "supervisor_0_LLC was killed by SIGKILL"),
        ("supervisor_0_LLC", signal.SIGSTOP, "supervisor_0_LLC is silent"),
        ("controller_0_LLC", signal.SIGSTOP, "controller_0_LLC is silent"),
    ],
)
def test_dead_or_silent_node_of_a_supervised_graph_is_named(
    tmp_path: Path, started: dict[str, Any], node: str, number: int, expected: str
) -> None:
    assert_named(["supervision=standard"], tmp_path, started, node, number, expected)


SERVED = [
    *("supervision=probed", "supervision.probe={start: null, cycles: 2}", "scenario=[]", "duration=8"),
    f"link={json.dumps({'up': [{'model': 'bernoulli', 'loss': 1.0, 'start': 5.0, 'duration': 0.5}]})}",
]


def test_services_do_what_an_operator_asks_for_or_say_why_not(start: Any, client: Any, tmp_path: Path) -> None:
    common = {"set": str(SERVED), "recorder": "true", "start_timeout": PATIENCE_S, "timeout": LOADED_S}
    recorder = start("recorder", output=tmp_path / "recording", **common)
    plant = start("plant_sim", **common)
    assert client(Trigger, "/plant_sim/pause", Trigger.Request()).success
    for name in ("wan_link", "controller", "supervisor"):
        start(name, **common)

    def asked(name: str) -> tuple[bool, str]:
        answer = client(Trigger, f"/supervisor/{name}", Trigger.Request())
        return answer.success, answer.message

    step(client, 30)
    assert asked("reset") == (False, "shadow; allowed: reset while disarmed, tripped")
    assert asked("arm") == (False, "not armed: no probe; allowed: after ~/probe")
    assert asked("probe")[0]
    step(client, 60)
    assert asked("arm")[0] is False  # while it goes on
    step(client, 150)  # 4 s
    assert asked("arm") == (True, "from tick 240 on")
    step(client, 20)
    assert asked("arm") == (False, "armed; allowed: arm while shadow")
    assert asked("probe") == (False, "armed; allowed: probe while shadow")
    step(client, 60)  # from 5 s on without frames: tripped
    assert asked("arm") == (False, "tripped; allowed: arm while shadow")
    assert asked("reset")[0]
    step(client, 2)
    refused = asked("arm")
    assert refused[0] is False
    assert refused[1].startswith("not armed: missing (time without frames from which its signals can be computed): ")
    assert refused[1].endswith(" s; allowed: 0.16")
    assert asked("disarm")[0]
    step(client, 30)
    assert asked("disarm") == (False, "disarmed; allowed: disarm while shadow, armed, fallback, tripped")
    assert client(Trigger, "/plant_sim/resume", Trigger.Request()).success
    plant.communicate(timeout=PATIENCE_S)
    recorder.stop()
    record = load(tmp_path / "recording")
    changes = [(change.tick, change.kind) for change in record.changes if change.role == "supervisor"]
    assert changes == [(30, "probe"), (240, "arm"), (320, "reset"), (322, "disarm")]
    assert states(record) == [
        *(("shadow", ""), ("armed", "operator"), ("tripped", "missing")),
        *(("shadow", "operator"), ("disarmed", "operator")),
    ]
    case = load_case(None, SERVED)
    assert_same(record, rerun(case, record.changes))
    part = replay.fitted(record, case)
    assert replay.first_supervised(part, replay.play(case, part)) is None
    assert_messages(payloads(tmp_path), record)
    logs = supervisor_logs(3)
    assert [(level, text.split(" at ")[0]) for level, text in logs] == [
        (20, "armed"),
        (30, "tripped"),
        (20, "disarmed"),
    ]
    assert "missing (time without frames" in logs[1][1]


def assert_messages(messages: dict[str, list[bytes]], record: Record) -> None:
    """State of each tick and levels of diagnostics in messages."""
    states = [deserialize_message(data, SupervisorState) for data in messages["/supervisor_0_LLC/state"]]
    assert [state.tick for state in states] == record.ticks.tolist()
    assert list(states[0].monitors) == list(MONITORS)
    for state, row in zip(states, record.supervision, strict=True):
        assert (state.controller, state.state) == ("controller_0_LLC", STATES[row["state"]])
        assert state.cause == cause_name(int(row["cause"]))
        assert np.array(state.values).tobytes() == row["values"].tobytes()
    assert list(states[0].limits) == [row.limit for row in MONITORS.values()]
    health = [
        status for data in messages["/diagnostics"] for status in deserialize_message(data, DiagnosticArray).status
    ]
    levels_found = {status.message.split(":")[0]: status.level for status in health if status.name == "supervisor"}
    levels = DiagnosticStatus.WARN, DiagnosticStatus.OK, DiagnosticStatus.WARN
    assert levels_found == dict(zip(("shadow", "armed", "disarmed"), levels, strict=True))


def supervisor_logs(many: int) -> list[tuple[int, str]]:
    """Level and text of the logs of supervisors that still run, once there are so many."""
    logs: list[tuple[int, str]] = []

    def keep(log: Log) -> None:
        if log.name == "supervisor" and " at " in log.msg:
            logs.append((log.level, log.msg))

    with somebody("listener") as (node, executor):
        node.create_subscription(Log, "/rosout", keep, qos_profile_rosout_default)
        wait_until(lambda: len(logs) >= many, meanwhile=lambda: executor.spin_once(0.1))
    return logs


def test_fallback_takes_over_from_a_controller_that_leaves_in_real_time(
    tmp_path: Path, started: dict[str, Any]
) -> None:
    def strike(done: int, _of: int) -> None:
        if done > 120 and "controller_0_LLC" in started:
            os.kill(started.pop("controller_0_LLC").process.pid, signal.SIGTERM)  # others need not wait for it

    case = load_case(None, [*ON, *FALLBACK, "link=csg"])
    outcome = graph.run(case, "realtime", tmp_path, strike, LOADED_S)
    assert [text.split()[0] for text in outcome.fallen] == ["controller_0_LLC"]
    record = load(outcome.recording)
    assert states(record)[-1] == ("fallback", "silent")
    assert len(record.time_ns) == case.ticks
    last = record.supervised[record.supervised["tick"] > 180]
    assert np.any(last["value"] != 0.0)
    assert not record.devices["released"].any()


def test_supervisor_that_dies_in_real_time_comes_back_in_shadow_and_is_armed_by_an_operator(
    start: Any, client: Any, tmp_path: Path
) -> None:
    run = Graph(start, tmp_path, set=str(["supervision=standard", "arm_at=0.5"]))
    run.add("wan_link", join="true")
    run.add("controller", join="true")
    first = run.add("supervisor", join="true")
    plant = run.add("plant_sim")
    run.run_until(120)
    assert not client(Trigger, "/supervisor/arm", Trigger.Request()).success  # and others know who will ask
    first.send_signal(signal.SIGKILL)
    killed = ticks(plant)
    run.run_until(killed + 60)  # by then the device has let go
    second = run.add("supervisor", join="true")
    run.run_until(killed + 240)  # it has joined: others have found the first one silent
    refused = client(Trigger, "/supervisor/arm", Trigger.Request())
    assert refused.message == "not armed: 1 device blocked or released; allowed: none; re-arm released devices first"
    assert client(Trigger, "/plant_sim/rearm", Trigger.Request()).success
    run.run_until(ticks(plant) + 10)
    assert client(Trigger, "/supervisor/arm", Trigger.Request()).success
    record = run.finish()
    assert second.texts()[0] == ""
    changes = [(change.kind, change.tick) for change in record.changes if change.role == "supervisor"]
    assert [kind for kind, _ in changes] == ["start", "arm"]
    began = changes[0][1]
    of_second = [(STATES[r["state"]], cause_name(int(r["cause"]))) for r in record.supervision if r["tick"] >= began]
    assert of_second[0] == ("shadow", "")
    assert ("armed", "operator") in of_second
    release = next(released for released in summarise(record).releases if released.time_s > killed / 60)
    assert release.time_s < began / 60 + 0.3
    armed = record.supervision[record.supervision["state"] == STATES.index("armed")]["tick"]
    acts, armed_s = record.devices["reference"][:, 0] != 0.0, armed[armed >= began][0] / 60
    assert not np.any(acts[(record.time_s > release.time_s + 0.6) & (record.time_s < armed_s)])
    assert np.any(acts[record.time_s > armed_s])
