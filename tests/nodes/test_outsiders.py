"""Nobody outside the loop holds it up: not a reader that has stopped, not the recorder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.nodes import graph
from facts_damping.nodes.node import DEPTH
from facts_damping.recording.reader import load
from facts_damping.recording.scan import scan
from facts_damping.simulation import loop
from tests.nodes.graphs import LOADED_S, assert_same

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FRAME_RATE = 60
MORE = 200  # ticks beyond what a publisher keeps

# Subscribes to what the plant says, as `ros2 topic echo --qos-reliability reliable --qos-history keep_all` does.
READER = """
import rclpy
from facts_damping_msgs.msg import PlantState, PmuDataFrame
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
reliable = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL, reliability=QoSReliabilityPolicy.RELIABLE, depth=0)
rclpy.init()
node = rclpy.create_node("reader")
node.create_subscription(PmuDataFrame, "pmu/frames", lambda _: print("heard", flush=True), reliable)
node.create_subscription(PlantState, "plant/state", lambda _: None, reliable)
rclpy.spin(node)
"""


@pytest.fixture
def reader(domain: int) -> Iterator[subprocess.Popen[str]]:
    popen = subprocess.Popen([sys.executable, "-c", READER], stdout=subprocess.PIPE, text=True)
    yield popen
    popen.kill()
    popen.communicate()


def seconds(ticks: int) -> float:
    return ticks / FRAME_RATE


def test_a_reader_that_stops_reading_holds_nobody_up(reader: subprocess.Popen[str], tmp_path: Path) -> None:
    case = load_case(None, [f"duration={seconds(DEPTH + 3 * MORE)}"])

    stopped: list[int] = []  # at which tick, once: who stands still says nothing any more

    def stop(done: int, _of: int) -> None:
        if done > 1 and not stopped and reader.stdout is not None:
            reader.stdout.readline()
            reader.send_signal(signal.SIGSTOP)
            stopped.append(done)

    outcome = graph.run(case, "lockstep", tmp_path, stop, LOADED_S)
    assert stopped[0] < 3 * MORE  # so that it lacks more than a publisher keeps
    assert outcome.messages_lost == 0
    assert_same(load(outcome.recording), loop.run(case))


def strike(started: dict[str, Any], number: int) -> None:
    os.kill(started["recorder"].process.pid, number)


def test_a_recorder_that_was_stopped_says_what_it_lost(domain: int, tmp_path: Path, started: dict[str, Any]) -> None:
    """The loop does not wait for it."""
    case = load_case(None, [f"duration={seconds(DEPTH + 15 * MORE)}"])

    def stop(done: int, _of: int) -> None:
        if done > 1:
            strike(started, signal.SIGSTOP if done < DEPTH + 12 * MORE else signal.SIGCONT)

    outcome = graph.run(case, "lockstep", tmp_path, stop, LOADED_S)
    frames = [message for message in scan(outcome.recording).messages if message.topic == "/pmu/frames"]
    recorded = load(outcome.recording)
    assert 0 < len(frames) < case.ticks
    said = f"/pmu/frames: the recorder lost {case.ticks - len(frames)} messages of /plant_sim"
    assert said in recorded.notes
    computed = loop.run(case)
    ticks = recorded.ticks
    assert recorded.frames.tobytes() == computed.frames[np.isin(computed.ticks, ticks)].tobytes()


def test_a_recorder_that_was_stopped_for_a_while_catches_up(
    domain: int, tmp_path: Path, started: dict[str, Any]
) -> None:
    case = load_case(None, ["duration=6"])

    def stop(done: int, _of: int) -> None:
        if done > 1:
            strike(started, signal.SIGSTOP if 60 < done < 240 else signal.SIGCONT)

    outcome = graph.run(case, "realtime", tmp_path, stop, LOADED_S)
    assert outcome.messages_lost == 0
    recorded = load(outcome.recording)
    assert len(recorded.time_ns) == case.ticks
    if outcome.deadline_misses == 0:
        assert_same(recorded, loop.run(case))
