"""What lost the grid, or the run, before devices let go and messages were checked: each with real nodes.

Elsewhere: a node that is killed at any time (`test_kills.py`), and started again (`test_joining.py`), a controller that
stands still (`test_watchdog.py`), readers and recorders that stop reading (`test_outsiders.py`), odd messages of all
kinds by the thousand (`test_guard.py`), a foreign message in a recording (`tests/recording/test_sifting.py`).
"""

from __future__ import annotations

import time
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from facts_damping_msgs.msg import PmuDataFrame, VoltageSetpoint, VoltageSetpoints
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import serialize_message

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.nodes import graph
from facts_damping.nodes.node import HEARING
from facts_damping.nodes.tables import FramesMessage, SetpointsMessage
from facts_damping.recording.reader import load
from facts_damping.signals import DELIVERY, NANOSECONDS, SETPOINT
from facts_damping.simulation import loop
from tests.nodes.graphs import LOADED_S, PATIENCE_S, assert_same, odd_requests
from tests.nodes.test_guard import HEARD, attacker

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.case.model import Case

RATE = 60
FAR = 10**9  # ticks
IN_2038 = 2_145_916_800 * NANOSECONDS
FLOOD_S = 3.0


def start_of(tick: int) -> int:
    return tick * NANOSECONDS // RATE


def forgeries(case: Case) -> dict[str, tuple[str, Callable[[int], bytes]]]:
    """Messages by what they are: topic, and the bytes at a tick."""
    frames, setpoints, controller = FramesMessage(case), SetpointsMessage(case), "controller_0_LLC"

    def measured(at: int) -> Any:
        rows = np.zeros(1, DELIVERY)
        rows["measured_ns"] = rows["arrival_ns"] = at
        rows["values"] = 0.02
        return rows

    def setpoint(tick: int) -> Any:
        rows = np.zeros(1, SETPOINT)
        rows["measured_ns"] = rows["issued_ns"] = rows["effective_ns"] = start_of(tick)
        rows["value"] = 0.1 if tick % 2 else -0.1
        return rows

    unknown = VoltageSetpoints(setpoints=[VoltageSetpoint(device="of nobody", controller=controller, value_pu=0.1)])
    none = np.zeros(0, SETPOINT)
    return {
        "empty, far": ("setpoints/delivered", lambda _: setpoints.fill(FAR, start_of(FAR), none, "")),
        "frames, far": ("pmu/frames", lambda _: frames.fill(FAR, start_of(FAR), measured(0), 1)),
        "of 2038": ("pmu/delivered", lambda tick: frames.fill(tick, IN_2038, measured(IN_2038), 1)),
        "valid": ("setpoints/delivered", lambda tick: setpoints.fill(tick, start_of(tick), setpoint(tick), "")),
        "in its name": (
            f"{controller}/setpoints",
            lambda tick: setpoints.fill(tick, start_of(tick), setpoint(tick), controller),
        ),
        "random": ("pmu/delivered", lambda tick: np.random.default_rng(tick).bytes(60)),
        "last tick": ("pmu/frames", lambda _: serialize_message(PmuDataFrame(tick=2**64 - 1))),
        "unknown device": ("setpoints/delivered", lambda _: serialize_message(unknown)),
    }


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_no_forgery_acts(domain: int, tmp_path: Path, started: dict[str, Any], mode: str) -> None:
    case = load_case(None, ["scenario=large", f"duration={60 if mode == 'lockstep' else 6}"])
    forged = forgeries(case)
    sent: Counter[str] = Counter()
    with attacker() as node:
        kinds = {"pmu": PmuDataFrame}
        publishers: dict[str, Any] = {}

        def progress(done: int, of: int) -> None:
            if not 1 < done < of - RATE:  # later, nodes may be leaving
                return
            if not publishers:
                for topic, _ in forged.values():
                    kind = kinds.get(topic.split("/")[0], VoltageSetpoints)
                    publishers[topic] = publishers.get(topic) or node.create_publisher(kind, topic, HEARING)
                odd_requests(node, started)
                deadline = time.monotonic() + PATIENCE_S
                while any(one.get_subscription_count() < 2 for one in publishers.values()):
                    assert time.monotonic() < deadline
                    time.sleep(0.01)
            for topic, make in forged.values():
                publishers[topic].publish(make(done))
                sent[topic] += 1

        outcome = graph.run(case, mode, tmp_path, progress, LOADED_S)
    recorded, computed = load(outcome.recording), loop.run(case)
    if mode == "lockstep" or outcome.deadline_misses == 0:
        assert_same(recorded, computed)
    assert summarise(recorded)["stable"] == summarise(computed)["stable"]
    refused: Counter[tuple[str, str]] = Counter()
    for (listener, cause, topic, _), count in outcome.messages_refused.items():
        assert cause in ("publisher", "request")
        refused[listener, topic] += count * (cause == "publisher")
    assert min(sent.values()) > 3
    for topic, count in sent.items():
        assert refused[HEARD[topic], f"/{topic}"] == refused["recorder", f"/{topic}"] == count


def test_a_flood_costs_time_and_is_told_and_nothing_else(domain: int, tmp_path: Path) -> None:
    """In real time: of one who sends as fast as he can to all that listen to setpoints and frames."""
    case = load_case(None, ["scenario=large", "duration=6"])
    sent = 0
    with attacker() as node:
        publishers: dict[str, Any] = {}

        def flood(done: int, _of: int) -> None:
            nonlocal sent
            if done < RATE or publishers:
                return
            for topic, make in forgeries(case).values():
                kind = PmuDataFrame if topic.startswith("pmu") else VoltageSetpoints
                publishers[topic] = (node.create_publisher(kind, topic, HEARING), make(done))
            until = time.monotonic() + FLOOD_S
            while time.monotonic() < until:
                for publisher, data in publishers.values():
                    with suppress(rclpy_implementation.RCLError):  # too many at once
                        publisher.publish(data)
                        sent += 1

        outcome = graph.run(case, "realtime", tmp_path, flood, LOADED_S)
    record, computed = load(outcome.recording), loop.run(case)
    assert len(record.time_ns) == case.ticks
    assert sent > 1000
    assert sum(outcome.messages_refused.values()) > sent / 2
    assert {cause for _, cause, _, _ in outcome.messages_refused} == {"publisher"}
    assert set(record.applied["value"].tolist()) <= set(record.issued["value"].tolist())
    assert summarise(record)["stable"] == summarise(computed)["stable"]
