"""Services that pause, step and change a run: what a lockstep graph records of it is what the loop gives in process."""

from __future__ import annotations

import os
import time
from typing import TYPE_CHECKING, Any

import pytest
from facts_damping_msgs.srv import Apply, Step
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.recording.reader import load
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun, with_event
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.replaying import replay
from tests.nodes.graphs import LOADED_S, PATIENCE_S, assert_same, payloads, set_parameter, step

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.usefixtures("loopback")

SETS = [
    *("scenario=large", "duration=7", "watchdog={good: 3}", "link=delay_100ms"),
    *("controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "controllers.0.signals=[frequency]"),
    "measurement=p_class",
]


def test_run_that_was_changed_under_way_is_its_recording_to_the_bit(start: Any, tmp_path: Path, client: Any) -> None:

    def trigger(name: str) -> None:
        answer = client(Trigger, f"/plant_sim/{name}", Trigger.Request())
        assert answer.success, answer.message

    def apply(node: str, text: str) -> bool:
        return bool(client(Apply, f"/{node}/apply", Apply.Request(change=text)).success)

    def set_to(node: str, name: str, value: float) -> bool:
        return bool(set_parameter(client, node, name, value).successful)

    common = {"set": str(SETS), "recorder": "true", "start_timeout": PATIENCE_S, "timeout": LOADED_S}
    recorder = start("recorder", output=tmp_path / "recording", **common)
    plant = start("plant_sim", **common)
    trigger("pause")  # answered while it waits for the others
    others = [start(name, **common) for name in ("wan_link", "controller", "identifier")]
    assert not client(Trigger, "/plant_sim/pause", Trigger.Request()).success
    assert not client(Step, "/plant_sim/step", Step.Request(ticks=0)).success
    assert set_to("controller", "leakage", 0.02)
    assert set_to("identifier", "identifier_eta", 1)  # a whole number is taken for a float
    step(client, 60)
    assert not apply("plant_sim", "{kind: line_out, line: nothing}")
    assert not apply("plant_sim", "[")
    assert not apply("wan_link", "{up: [{delay: -1}]}")
    os.mkfifo(tmp_path / "pipe.yaml")
    (tmp_path / "link.yaml").write_text("{}")
    for text in ("pipe.yaml", "link.yaml", "{{up: [{{model: trace, file: {}/link.yaml}}]}}"):
        assert not apply("wan_link", text.format(tmp_path) if "{" in text else f"{tmp_path / text}")
    assert apply("plant_sim", "{kind: load_step, load: load_1, change: 0.05}")
    assert apply("plant_sim", "{kind: forced_oscillation, load: load_2, frequency: 0.7, amplitude: 0.02, duration: 1}")
    assert set_to("wan_link", "up.0.delay", 0.03)
    assert not set_to("wan_link", "up.0.start", 1.0)
    assert set_to("plant_sim", "noise.angle", 0.002)
    assert not set_to("plant_sim", "noise.angle", -1.0)
    step(client, 60)
    delays = "{model: uniform, low: 0.01, high: 0.05}"
    assert apply("wan_link", f"{{up: [{delays}, {{model: duplicate, probability: 0.2}}], down: [{{delay: 0.5}}]}}")
    step(client, 120)
    trigger("reset")
    assert set_to("plant_sim", "noise.magnitude", 0.003)  # beside the one before the reset
    assert apply("wan_link", "ideal")
    assert apply("plant_sim", "{kind: line_out, line: line_2}")
    assert not apply("plant_sim", "{kind: line_out, line: line_2}")  # it will be out
    trigger("resume")
    plant.communicate(timeout=PATIENCE_S)
    recorder.terminate()
    for node in (plant, recorder):
        assert node.communicate(timeout=PATIENCE_S)[1] == ""
        assert node.returncode == 0
    assert [node.poll() for node in others] == [None] * 3  # they are another program's to stop

    case = load_case(None, SETS)
    record = load(tmp_path / "recording")
    kinds = [(change.role, change.kind, change.name) for change in record.changes]
    assert sorted(kinds) == sorted(
        [
            *(("plant", kind, "") for kind in ("pause", "resume", "reset", *("step", "event") * 3)),
            *(("plant", "parameter", f"noise.{name}") for name in ("angle", "magnitude")),
            ("controller", "parameter", "leakage"),
            ("identifier", "parameter", "identifier_eta"),
            ("link", "parameter", "up.0.delay"),
            *[("link", "link", "")] * 2,
        ]
    )
    assert summarise(record).releases, "the slow link should have had the device let go"
    again = rerun(case, record.changes)
    assert_same(record, again)
    mine = replay.case_of(record, "it", None, [])
    part = replay.fitted(record, mine)
    issued, estimates, *_ = replay.play(mine, part)
    assert replay.first_difference(part, issued) is None
    assert replay.first_estimate(part, estimates) is None
    assert replay.watched(mine, part).devices["released"].tobytes() == part.devices["released"].tobytes()


def test_events_that_are_asked_for_are_those_of_a_file_to_the_bit(start: Any, tmp_path: Path, client: Any) -> None:
    rows = [
        "kind: brake, bus: B9, power: 300, duration: 0.25",
        "kind: forced_oscillation, machine: G1, frequency: 0.7, amplitude: 0.05, ramp: 0.5",
    ]
    sets = ["scenario=[]", "duration=2"]
    common = {"set": str(sets), "recorder": "true", "start_timeout": PATIENCE_S, "timeout": LOADED_S}
    recorder = start("recorder", output=tmp_path / "recording", **common)
    plant = start("plant_sim", **common)
    assert client(Trigger, "/plant_sim/pause", Trigger.Request()).success
    others = [start(name, **common) for name in ("wan_link", "controller")]
    step(client, 30)
    for row in rows:
        assert client(Apply, "/plant_sim/apply", Apply.Request(change=f"{{{row}}}")).success
    assert client(Trigger, "/plant_sim/resume", Trigger.Request()).success
    assert plant.communicate(timeout=PATIENCE_S)[1] == ""
    recorder.terminate()
    assert recorder.communicate(timeout=PATIENCE_S)[1] == ""
    assert [node.poll() for node in others] == [None] * 2
    record = load(tmp_path / "recording")
    tick = next(change.tick for change in record.changes if change.kind == "event")
    listed = ", ".join(f"{{time: {tick_ns(tick, 60) / NANOSECONDS!r}, {row}}}" for row in rows)
    expected = loop.run(load_case(None, [*sets, f"scenario=[{listed}]"]))
    for name in ("frames", "machines", "devices", "issued", "applied"):
        assert getattr(record, name).tobytes() == getattr(expected, name).tobytes(), name
    assert str(record.events) == str(expected.events)
    assert [event.kind for event in record.events] == ["brake", "forced_oscillation", "brake_out"]


def test_pause_is_taken_for_silence_by_nobody(start: Any, client: Any, tmp_path: Path) -> None:
    common = {"recorder": "true", "start_timeout": PATIENCE_S, "timeout": 1.5, "duration": 2}
    recorder = start("recorder", output=tmp_path / "recording", **common)
    plant = start("plant_sim", **common)
    assert client(Trigger, "/plant_sim/pause", Trigger.Request()).success
    nodes = [start(name, **common) for name in ("wan_link", "controller")]
    assert client(Step, "/plant_sim/step", Step.Request(ticks=60)).success
    time.sleep(4.0)
    assert plant.texts()[0].splitlines()[-1].split()[1] == "60"
    until_ns = time.time_ns()  # after the run nothing comes indeed
    assert client(Trigger, "/plant_sim/resume", Trigger.Request()).success
    assert plant.communicate(timeout=PATIENCE_S)[1] == ""
    assert [plant.returncode, *(node.poll() for node in nodes)] == [0, None, None]
    recorder.stop()
    diagnostics = payloads(tmp_path, until_ns)["/diagnostics"]
    assert not any(b"nothing has come" in data for data in diagnostics if b"wan_link" in data)


def test_paused_run_answers_and_ends_when_told(start: Any, client: Any) -> None:
    plant = start("plant_sim", mode="free")
    plant.wait(lambda: "tick" in plant.texts()[0], PATIENCE_S)
    assert client(Trigger, "/plant_sim/pause", Trigger.Request()).success
    assert not client(Trigger, "/plant_sim/rearm", Trigger.Request()).success
    before = plant.texts()[0].splitlines()[-1]
    time.sleep(1.5)
    assert plant.texts()[0].splitlines()[-1].split()[1] == before.split()[1]
    plant.terminate()
    assert plant.communicate(timeout=PATIENCE_S)[1] == ""
    assert plant.returncode == 0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{kind: line_out}", "line: missing"),
        ("{kind: clear, bus: B7}", "which has no fault"),
        ("{kind: storm}", "'storm' given"),
        ("{time: 3, kind: line_out, line: line_1}", "without time"),
        ("tie", "without time"),
    ],
)
def test_events_that_cannot_be_are_refused_in_a_line(text: str, expected: str) -> None:
    with pytest.raises(InputError, match=expected) as refused:
        with_event(load_case(None, []), text, 10**9)
    assert "\n" not in str(refused.value)
