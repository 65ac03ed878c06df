"""Nodes in mode free, started one by one: no node waits, and each may leave and come again."""

from __future__ import annotations

import os
import signal
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rcl_interfaces.srv import ListParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from tests.nodes.graphs import (
    BEGUN,
    PATIENCE_S,
    assert_replayed,
    payloads,
    set_parameter,
    somebody,
    ticks,
    wait_until,
    wait_until_recording,
)

if TYPE_CHECKING:
    from pathlib import Path

# Of 60 s: the recorder comes at 5 s, link and controller at 10 s, leave at 30 s, come again at 40 s.
WHOLE_S = float(os.environ.get("FREE_RUN_S", "12"))
RATE = 60
FREE = {"mode": "free"}


def until(plant: Any, seconds: float) -> None:
    plant.wait(lambda: plant.poll() is not None or ticks(plant) >= seconds * RATE, PATIENCE_S)


def stop(*nodes: Any) -> None:
    for node in nodes:
        node.send_signal(signal.SIGINT)
    for node in nodes:
        node.communicate(timeout=PATIENCE_S)
        assert node.returncode == 0, node.texts()


def test_plant_alone_publishes_at_once_and_others_come_go_and_come_again(
    loopback: Any, start: Any, client: Any, tmp_path: Path
) -> None:
    common = {**FREE, "duration": WHOLE_S, "scenario": "large"}
    part = WHOLE_S / 60.0
    plant = start("plant_sim", **common)
    until(plant, 5 * part)
    recorder = start("recorder", output=tmp_path / "bag", **common)
    wait_until_recording(tmp_path / "bag", BEGUN)
    until(plant, 10 * part)

    def both() -> tuple[Any, Any]:
        return start("wan_link", **common), start("controller", **common)

    nodes = both()
    until(plant, 30 * part)
    stop(*nodes)
    until(plant, 40 * part)
    nodes = both()
    for name in ("wan_link", "controller"):  # both are there
        client(ListParameters, f"/{name}/list_parameters", ListParameters.Request())
    until(plant, 47 * part)
    rearmed = client(Trigger, "/plant_sim/rearm", Trigger.Request())
    assert (rearmed.success, rearmed.message) == (True, "re-armed: sssc")
    plant.finish()
    stop(*nodes, recorder)

    record = load(tmp_path / "bag")
    first, last = int(record.ticks[0]), int(record.ticks[-1])
    assert 5 * part * RATE <= first
    assert last == round(WHOLE_S * RATE) - 1
    assert record.ticks.tolist() == list(range(first, last + 1))  # frames without a gap
    kinds = sorted((change.role, change.kind) for change in record.changes)
    assert kinds == [*[("controller", "start")] * 2, *[("link", "start")] * 2, ("plant", "rearm")]
    joined = [change.tick / RATE for change in record.changes if change.role == "controller"]
    assert first / RATE < joined[0]
    reference = record.devices["reference"][:, 0]
    assert np.all(reference[record.time_s < joined[0]] == 0.0)
    release: Any
    (release,) = summarise(record).releases
    assert 30 * part < release.time_s < joined[1]
    assert joined[1] < release.rearmed_s
    between = (record.time_s > joined[0] + 1.0) & (record.time_s < release.time_s)
    assert np.any(reference[between] != 0.0)
    at_rest = (record.time_s > release.time_s + 0.6) & (record.time_s < release.rearmed_s)
    assert np.all(reference[at_rest] == 0.0)
    assert np.any(record.issued["tick"] / RATE > joined[1])
    assert record.gap_tick is None
    assert_replayed(record)
    assert "/plant_sim" in record.publishers.values()


def test_default_run_stands_at_rest_until_an_event_is_called_for(
    loopback: Any, start: Any, client: Any, tmp_path: Path
) -> None:
    recorder = start("recorder", output=tmp_path / "bag", **FREE)
    plant = start("plant_sim", **FREE)
    until(plant, 1.0)
    step = "{kind: load_step, load: load_2, change: -0.1}"
    for text, allowed in ((step.replace("load_2", "load_9"), False), (step, True)):
        result = set_parameter(client, "plant_sim", "event", text)
        assert result.successful == allowed
        assert ("load_9" in result.reason) != allowed
    until(plant, ticks(plant) / RATE + 1.0)
    stop(plant, recorder)
    record = load(tmp_path / "bag")
    (event,) = record.events
    speeds = np.abs(record.machines["speed_deviation"]).max(axis=1)
    assert np.all(speeds[record.time_ns <= event.time_ns] < 1e-12)
    assert speeds[-1] > 1e-4


def test_ten_minutes_at_rest_and_a_swing_that_settles() -> None:
    """A frequency that leaves its band ends it as a loss of synchronism, with the reason."""
    rest = loop.run(load_case("two_area_free", ["duration=600"]))
    assert np.abs(rest.machines["speed_deviation"]).max() < 1e-12
    assert rest.in_synchronism.all()
    step = "scenario=[{time: 1, kind: load_step, load: load_2, change: -0.1}]"
    swing = loop.run(load_case("two_area_free", [step, "duration=120"]))
    assert np.abs(swing.machines["speed_deviation"][-1]).max() < 0.002
    drifts = summarise(loop.run(load_case(None, [step, "duration=120"])))
    assert (drifts.verdict, drifts.instability) == ("lost synchronism", "frequency beyond 48 to 72 Hz")


@pytest.mark.parametrize("stamp", ["simulated", "wall"])
def test_another_plant_is_followed_and_ends_a_recording(loopback: Any, start: Any, tmp_path: Path, stamp: str) -> None:
    assert_followed(start, tmp_path, stamp)


def test_another_plant_is_followed_on_dds(start: Any, tmp_path: Path) -> None:
    assert_followed(start, tmp_path, "simulated")


def assert_followed(start: Any, tmp_path: Path, stamp: str) -> None:
    """By link, controller and identifier, who begin again; a recording is of one run."""
    common = {**FREE, "set": str(["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])}
    recorder = start("recorder", output=tmp_path / "bag", **common)
    others = [start(name, **common) for name in ("wan_link", "controller", "identifier")]
    plant = start("plant_sim", stamp=stamp, **common)
    until(plant, 1.0)
    stop(plant)
    second = start("plant_sim", stamp=stamp, **common)
    recorder.communicate(timeout=PATIENCE_S)
    assert recorder.returncode == 0
    bag = start("recorder", output=tmp_path / "second", **common)
    wait_until_recording(tmp_path / "second", BEGUN)
    until(second, ticks(second) / RATE + 1.0)
    stop(second, *others, bag)
    assert load(tmp_path / "bag").ticks[-1] >= 59
    record = load(tmp_path / "second")
    assert set(record.issued["controller"]) == {0}
    assert len(record.estimates) > 0


def test_clock_is_the_simulated_time(loopback: Any, start: Any) -> None:
    plant = start("plant_sim", use_sim_time="true", **FREE)
    controller = start("controller", use_sim_time="true", **FREE)
    link = start("wan_link", use_sim_time="true", **FREE)
    simulated = [Parameter("use_sim_time", value=True)]
    with somebody("listener", parameter_overrides=simulated) as (node, executor):
        clock = node.get_clock()
        wait_until(lambda: clock.now().nanoseconds > 2 * 10**9, meanwhile=lambda: executor.spin_once(0.1))
        assert abs(clock.now().nanoseconds * 1e-9 - ticks(plant) / RATE) < 1.0
    stop(plant, link, controller)


@pytest.mark.parametrize("executable", ["plant_sim", "wan_link", "controller"])
def test_killed_plant_or_peer_leaves_the_others_running(loopback: Any, start: Any, executable: str) -> None:
    nodes = {name: start(name, **FREE) for name in ("plant_sim", "wan_link", "controller")}
    until(nodes["plant_sim"], 1.5)
    nodes.pop(executable).send_signal(signal.SIGKILL)
    time.sleep(2.0)
    assert [node.poll() for node in nodes.values()] == [None, None]
    stop(*nodes.values())


def test_stamps_may_be_wall_time(loopback: Any, start: Any, tmp_path: Path) -> None:
    """On the wire, so that `ros2 topic delay` is sensible; what is read of the recording begins with 0."""
    sets = ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect", "scenario=large"]
    common = {"mode": "realtime", "recorder": "true", "duration": 3.0, "start_timeout": PATIENCE_S, "set": str(sets)}
    recorder = start("recorder", output=tmp_path / "recording", **common)
    for name in ("wan_link", "controller", "identifier"):
        start(name, **common)
    plant = start("plant_sim", stamp="wall", **common)
    assert plant.communicate(timeout=PATIENCE_S)[1] == ""
    stop(recorder)
    now = time.time()
    for topic, messages in payloads(tmp_path).items():
        for data in messages:
            if b"nothing has come" in data:
                continue  # a node that waited for the plant did not know the time
            seconds = int.from_bytes(data[4:8], "little")
            assert now - PATIENCE_S < seconds <= now, topic
    record = load(tmp_path / "recording")
    assert record.notes == []
    assert record.time_ns.tolist() == [tick * 10**9 // RATE for tick in range(180)]
    assert (summarise(record).latency_ms.max or 0.0) < 1000.0
    assert record.events[0].time_ns == 10**9
    assert len(record.estimates) > 150
    assert record.estimates["measured_ns"].max() < 3 * 10**9
    assert_replayed(record)


def test_stamps_in_lockstep_are_simulated(loopback: Any, start: Any) -> None:
    plant = start("plant_sim", stamp="wall")
    errors = plant.communicate(timeout=PATIENCE_S)[1]
    assert (plant.returncode, errors) == (2, "plant_sim: stamp: 'wall' given; allowed with mode lockstep: simulated\n")
