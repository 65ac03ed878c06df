"""Ticks per second of the lockstep graph, and its share of what DDS's latency alone allows, in one run."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from facts_damping_msgs.msg import PmuDataFrame, PmuFrame
from mcap.reader import make_reader

from facts_damping.case.loading import load_case
from facts_damping.nodes import graph
from facts_damping.nodes.node import RELIABLE
from facts_damping.nodes.spinning import Spinner

ROUND_TRIPS = 3000
HOPS = 4  # plant -> link -> controller -> link -> plant
SECONDS = 60.0  # simulated
QUIET_S = 10.0  # after which the echo ends


def echo() -> None:
    """Send back what comes, as raw bytes, until nothing comes any more."""
    rclpy.init()
    node = rclpy.create_node("echo")
    back = node.create_publisher(PmuDataFrame, "back", RELIABLE)
    node.create_subscription(PmuDataFrame, "there", lambda data, _info: back.publish(data), RELIABLE, raw=True)
    spinner = Spinner(node)
    heard = time.monotonic()
    while time.monotonic() - heard < QUIET_S:
        if spinner.spin_once(0.1):
            heard = time.monotonic()


def one_way_latency_s() -> float:
    """Median half of a round trip between two processes, a frame of five stations as raw bytes, s."""
    other = subprocess.Popen([sys.executable, __file__, "echo"])
    rclpy.init()
    node = rclpy.create_node("latency")
    there = node.create_publisher(PmuDataFrame, "there", RELIABLE)
    got: list[float] = []
    node.create_subscription(PmuDataFrame, "back", lambda *_: got.append(time.perf_counter()), RELIABLE, raw=True)
    spinner = Spinner(node)
    message = PmuDataFrame(frames=[PmuFrame(station=name) for name in ("G1", "G2", "G3", "G4", "TIE")])
    while there.get_subscription_count() < 1 or node.count_publishers("back") < 1:
        time.sleep(0.05)
    trips = []
    for _ in range(ROUND_TRIPS):
        count, began = len(got), time.perf_counter()
        there.publish(message)
        while len(got) == count:
            spinner.turn(1.0)
        trips.append(got[-1] - began)
    spinner.close()
    node.destroy_node()
    rclpy.shutdown()
    other.terminate()
    other.kill()
    other.wait()
    return statistics.median(trips) / 2


def ticks_per_second() -> tuple[float, int]:
    """Ticks per second of the graph between its first and its last frame, and messages lost."""
    with tempfile.TemporaryDirectory() as folder:
        case = load_case(None, [f"duration={SECONDS}"])
        outcome = graph.run(case, "lockstep", Path(folder), lambda *_: None)
        with next(outcome.recording.glob("*.mcap")).open("rb") as stream:
            times = [m.publish_time for _, _, m in make_reader(stream).iter_messages(topics=["/pmu/frames"])]
    return (len(times) - 1) / (max(times) - min(times)) * 1e9, outcome.messages_lost


def main() -> None:
    """Print ticks/s, times real time, and the share of the limit."""
    rate, lost = ticks_per_second()
    latency = one_way_latency_s()
    limit = 1.0 / (HOPS * latency)
    print(f"lockstep, two_area, all nodes and recorder: {rate:.0f} ticks/s, {rate / 60:.1f} times real time")
    print(f"messages lost: {lost}")
    print(f"DDS one-way latency {latency * 1e6:.0f} us, {HOPS} hops: limit {limit:.0f} ticks/s")
    print(f"share of the limit: {rate / limit:.0%}")


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo()
    else:
        main()
