"""Neither a stopped reader nor the recorder delays the loop; the recorder reports what it has lost."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from facts_damping_msgs.msg import PmuDataFrame
from rclpy.qos import QoSHistoryPolicy

from facts_damping.case.loading import load_case
from facts_damping.nodes.base.qos import DEPTH, SUBSCRIBER_QOS
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.recording.scan import scan
from facts_damping.simulation import loop
from facts_damping_testing.loopback.domain import domain as of_loopback
from facts_damping_testing.loopback.topics import Subscription
from tests.nodes.graphs import LOADED_S, PATIENCE_S, assert_same, quiet

if TYPE_CHECKING:
    from pathlib import Path

SENT = DEPTH + 3000  # more than a publisher keeps, and the system for a reader
WRITER = """
import sys, time, rclpy
from std_msgs.msg import String
from facts_damping.nodes.base import qos, run
run._set_up_middleware()
rclpy.init()
own = rclpy.create_node("writer")
publisher = own.create_publisher(String, "topic", qos.PUBLISHER_QOS)
while publisher.get_subscription_count() < 1:
    time.sleep(0.01)
print("found", flush=True)
sys.stdin.readline()
for k in range(int(sys.argv[1])):
    publisher.publish(String(data=f"{k} {'x' * 4000}"))
print("published", flush=True)
sys.stdin.readline()
"""
# As the recorder does, and `ros2 topic echo --qos-reliability reliable --qos-history keep_all`.
READER = """
import sys, rclpy
from std_msgs.msg import String
from facts_damping.nodes.base import qos, run
run._set_up_middleware()
rclpy.init()
own, received = rclpy.create_node("reader"), []
def receive(message, information):
    received.append((int(message.data.split()[0]), information["publication_sequence_number"]))
own.create_subscription(String, "topic", receive, qos.SUBSCRIBER_QOS)
while not received or received[-1][0] < int(sys.argv[1]) - 1:
    rclpy.spin_once(own)
print(*(k for k, _ in received))
print(*(number for _, number in received))
"""


def line(node: subprocess.Popen[str]) -> str:
    """The next line that a node says; none if it says nothing."""
    assert node.stdout is not None
    there, _, _ = select.select([node.stdout], [], [], PATIENCE_S)
    return node.stdout.readline() if there else ""


def test_stopped_subscriber_loses_messages_and_delays_no_publisher(domain: int) -> None:
    def run(code: str) -> subprocess.Popen[str]:
        node = subprocess.Popen([sys.executable, "-c", code, str(SENT)], stdin=-1, stdout=-1, text=True)
        ended.callback(node.kill)
        return node

    with ExitStack() as ended:
        reader, writer = run(READER), run(WRITER)
        assert line(writer) == "found\n"
        reader.send_signal(signal.SIGSTOP)
        print("go", file=writer.stdin, flush=True)
        text = line(writer)
        reader.send_signal(signal.SIGCONT)
        out, _ = reader.communicate(timeout=PATIENCE_S)
        received, numbers = (list(map(int, text.split())) for text in out.splitlines())
        writer.communicate(timeout=PATIENCE_S)
    assert text == "published\n"
    assert DEPTH <= len(received) < SENT
    assert received == sorted(set(received))
    assert numbers == [k + numbers[0] - received[0] for k in received]  # what is missing shows


def test_recorder_notes_what_it_lost_from_queues_of_bounded_depth(loopback: Any, tmp_path: Path) -> None:
    """A foreign node discards the messages for the recorder for a while; the loop does not wait for it."""
    case = load_case(None, ["duration=3", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
    profiles: list[Any] = []

    def lose() -> None:
        rclpy.init()
        node = rclpy.create_node("thief")

        def steal(data: bytes) -> None:
            if not profiles:
                for topic, _ in node.get_topic_names_and_types():
                    profiles.extend(endpoint.qos_profile for endpoint in node.get_publishers_info_by_topic(topic))
            if 40 < int.from_bytes(data[20:28], "little") < 100:
                for subscription in of_loopback().of(Subscription):
                    if subscription.node.get_node_name() == "recorder" and subscription.name == "/pmu/frames":
                        subscription.waiting.clear()

        node.create_subscription(PmuDataFrame, "pmu/frames", steal, SUBSCRIBER_QOS, raw=True)
        rclpy.spin(node)

    loopback.start("thief", lose)
    outcome = graph.run(case, "realtime", tmp_path, quiet, LOADED_S)
    assert len(profiles) > 20
    assert all(profile.history == QoSHistoryPolicy.KEEP_LAST and profile.depth <= DEPTH for profile in profiles)
    frames = [message for message in scan(outcome.recording).messages if message.topic == "/pmu/frames"]
    recorded, computed = load(outcome.recording), loop.run(case)
    assert 0 < outcome.messages_lost == case.ticks - len(frames) < case.ticks
    assert outcome.ticks == case.ticks
    assert f"/pmu/frames: the recorder lost {outcome.messages_lost} messages of /plant_sim" in recorded.notes
    assert recorded.frames.tobytes() == computed.frames[np.isin(computed.ticks, recorded.ticks)].tobytes()
    assert recorded.issued.tobytes() == computed.issued.tobytes()


def test_recorder_that_was_stopped_for_a_while_catches_up(domain: int, tmp_path: Path, started: dict[str, Any]) -> None:
    case = load_case(None, ["duration=3"])

    def stop(done: int, _of: int) -> None:
        if done > 1:
            os.kill(started["recorder"].process.pid, signal.SIGSTOP if 30 < done < 120 else signal.SIGCONT)

    outcome = graph.run(case, "realtime", tmp_path, stop, LOADED_S)
    assert outcome.messages_lost == 0
    recorded = load(outcome.recording)
    assert len(recorded.time_ns) == case.ticks
    if outcome.deadline_misses == 0:
        assert_same(recorded, loop.run(case))
