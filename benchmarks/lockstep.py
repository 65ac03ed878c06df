"""Ticks per second of two lockstep graphs, and its fraction of what DDS's latency alone allows, in one run."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time

import rclpy
from facts_damping_msgs.msg import PmuDataFrame, PmuFrame

from facts_damping.nodes.base.qos import PUBLISHER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.spinner import Spinner
from facts_damping_bench.ticks import ours

ROUND_TRIPS = 3000
HOPS = 4  # plant -> link -> controller -> link -> plant
RUNS = ("two_area_small", "two_area_deployment")  # the lightest; and with PMUs, jitter, a supervisor
QUIET_S = 10.0  # after which the echo ends


def echo() -> None:
    """Send back what comes, as raw bytes, until nothing comes any more."""
    rclpy.init()
    node = rclpy.create_node("echo")
    back = node.create_publisher(PmuDataFrame, "back", PUBLISHER_QOS)
    node.create_subscription(PmuDataFrame, "there", lambda data, _info: back.publish(data), SUBSCRIBER_QOS, raw=True)
    spinner = Spinner(node)
    latest = time.monotonic()
    while time.monotonic() - latest < QUIET_S:
        if spinner.spin_once(0.1):
            latest = time.monotonic()


def one_way_latency_s() -> float:
    """Median half of a round trip between two processes, a frame of five PMUs as raw bytes, s."""
    other = subprocess.Popen([sys.executable, __file__, "echo"])
    rclpy.init()
    node = rclpy.create_node("latency")
    there = node.create_publisher(PmuDataFrame, "there", PUBLISHER_QOS)
    arrivals: list[float] = []
    node.create_subscription(
        PmuDataFrame, "back", lambda *_: arrivals.append(time.perf_counter()), SUBSCRIBER_QOS, raw=True
    )
    spinner = Spinner(node)
    message = PmuDataFrame(frames=[PmuFrame(pmu=name) for name in ("G1", "G2", "G3", "G4", "TIE")])
    while there.get_subscription_count() < 1 or node.count_publishers("back") < 1:
        time.sleep(0.05)
    trips = []
    for _ in range(ROUND_TRIPS):
        count, began = len(arrivals), time.perf_counter()
        there.publish(message)
        while len(arrivals) == count:
            spinner.spin_once(1.0)
        trips.append(arrivals[-1] - began)
    spinner.close()
    node.destroy_node()
    rclpy.shutdown()
    other.terminate()
    other.kill()
    other.wait()
    return statistics.median(trips) / 2


def main() -> None:
    """Print ticks/s, times real time, and the fraction of the limit."""
    latency = one_way_latency_s()
    limit = 1.0 / (HOPS * latency)
    print(f"DDS one-way latency {latency * 1e6:.0f} us, {HOPS} hops: limit {limit:.0f} ticks/s")
    for run in RUNS:
        rate = ours(run)
        times = f"{rate / 60:.1f} times real time, {rate / limit:.0%} of the limit"
        print(f"lockstep, {run}, all nodes and recorder: {rate:.0f} ticks/s, {times}")


if __name__ == "__main__":
    if sys.argv[1:] == ["echo"]:
        echo()
    else:
        main()
