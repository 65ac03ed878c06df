"""Foreign messages have no effect on a graph.

Elsewhere: message filters (`test_message_filter.py`), nodes that are killed (`test_kills.py`), started again
(`test_joining.py`) or stopped (`test_watchdog.py`), readers that stop reading (`test_outsiders.py`), foreign messages
in a recording (`tests/recording/test_validation.py`).
"""

from __future__ import annotations

import itertools
import os
import signal
import time
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rclpy
from facts_damping_msgs.msg import PmuDataFrame
from facts_damping_msgs.srv import Step
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from std_srvs.srv import Trigger

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.nodes import recorder
from facts_damping.nodes.base.qos import LATCHED_SUBSCRIBER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_testing.foreign.messages import hostile
from tests.nodes.graphs import LOADED_S, assert_same, odd_requests, quiet, somebody, wait_until
from tests.nodes.hostile import IDENTIFIER, LATEST, SETS, forgeries

if TYPE_CHECKING:
    from pathlib import Path

    from rclpy.node import Node

    from facts_damping.case.model import Case
    from facts_damping.nodes.launching.graph import Outcome

HOSTILE = int(os.environ.get("HOSTILE_MESSAGES", "4000")) // 2  # to each of two graphs on the loopback
FLOOD = 3000  # messages
BEGUN = 10  # tick by which a graph is complete: who is there before would be refused as another one's


class Attacker:
    """A foreign node that publishes forged and odd messages on every topic of a graph."""

    def __init__(self, node: Node, case: Case) -> None:
        self.node, self.rng, self.forged = node, np.random.default_rng(7), forgeries(case)
        self.kinds = list(recorder.topics(case).items())
        self.publishers = {
            topic: node.create_publisher(
                kind, topic, LATCHED_SUBSCRIBER_QOS if topic in recorder.LATE else SUBSCRIBER_QOS
            )
            for topic, kind in self.kinds
        }
        self.sent: Counter[str] = Counter()

    def missing(self) -> list[str]:
        """Topics whose publisher here some subscribers have not found."""
        counts = {topic: publisher.get_subscription_count() for topic, publisher in self.publishers.items()}
        return [topic for topic, count in counts.items() if count <= len(LATEST.get(topic, ()))]

    def publish(self, topic: str, data: bytes) -> None:
        self.publishers[topic].publish(data)
        self.sent[topic] += 1

    def forge(self, tick: int) -> None:
        for topic, make in self.forged:
            self.publish(topic, make(tick))

    def hostile(self) -> tuple[str, bytes]:
        """A topic and an odd message for it."""
        topic, kind = self.kinds[self.rng.integers(len(self.kinds))]
        return topic, hostile(self.rng, kind)


def assert_all_refused(sent: Counter[str], outcome: Outcome, recorded: Any) -> None:
    """Each message is counted by all that received it, and the recording has these counts."""
    refused: Counter[tuple[str, str]] = Counter()
    for (listener, cause, topic, _), count in outcome.messages_refused.items():
        refused[listener, topic] += count * (cause != "request")
    for topic, count in sent.items():
        for listener in {"recorder"} | LATEST.get(topic, set()):
            assert refused[listener, topic if topic.startswith("/") else f"/{topic}"] == count, (listener, topic)
    for row in recorded.refused:
        key = row.node.strip("/"), row.cause, row.topic, row.source
        assert row.count == outcome.messages_refused[key]


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_forged_and_malformed_messages_have_no_effect(
    loopback: Any, tmp_path: Path, started: dict[str, Any], mode: str
) -> None:
    case = load_case(None, [*SETS, "duration=4"])
    ends = case.ticks - case.run.frame_rate  # later, nodes may be leaving
    each = -(-HOSTILE // (ends - BEGUN))
    sent: Counter[str] = Counter()

    def attack() -> None:
        rclpy.init()
        node = rclpy.create_node("attacker")
        ticks = itertools.count()
        attackers: list[Attacker] = []
        plant: list[bytes] = []

        def on_frame(_data: bytes, information: Any) -> None:
            plant.append(information["publisher_gid"]["data"])
            if plant[-1] != plant[0]:
                return  # its own
            tick = next(ticks)
            if tick == BEGUN:
                if mode == "lockstep":  # nodes may not have looked at anything yet: ticks take no time
                    pause(started, signal.SIGSTOP)
                    time.sleep(0.1)
                    pause(started, signal.SIGCONT)
                attackers.append(Attacker(node, case))
                odd_requests(node, started)
            if BEGUN <= tick < ends:
                attackers[0].forge(tick)
                for _ in range(each):
                    attackers[0].publish(*attackers[0].hostile())
                sent.update(attackers[0].sent)
                attackers[0].sent.clear()

        node.create_subscription(PmuDataFrame, "pmu/frames", on_frame, SUBSCRIBER_QOS, raw=True)
        rclpy.spin(node)

    loopback.start("attacker", attack)
    outcome = graph.run(case, mode, tmp_path, quiet, LOADED_S)
    recorded = load(outcome.recording)
    assert sent.total() >= HOSTILE
    assert set(sent) == set(recorder.topics(case))
    assert outcome.deadline_misses == 0
    assert_same(recorded, loop.run(case))
    assert {how[1] for how in outcome.messages_refused} <= {"publisher", "request"}  # as of nobody of the graph
    assert_all_refused(sent, outcome, recorded)


def pause(started: dict[str, Any], number: int) -> None:
    """Send a signal to the identifier, for which the run waits."""
    os.kill(started[IDENTIFIER].process.pid, number)


def test_messages_of_another_dds_participant_have_no_effect(
    domain: int, tmp_path: Path, started: dict[str, Any], client: Any
) -> None:
    """As above over DDS; the run pauses until the other participant is found."""
    case = load_case(None, [*SETS, "duration=2"])
    attackers: list[Attacker] = []
    asked: list[bool] = []

    def look(tick: int, _nodes: Any) -> None:
        if not asked:  # the plant answers while it waits for the others
            pause(started, signal.SIGSTOP)
            asked.append(client(Trigger, "/plant_sim/pause", Trigger.Request()).success)
            asked.append(client(Step, "/plant_sim/step", Step.Request(ticks=BEGUN)).success)
            pause(started, signal.SIGCONT)
        if tick < BEGUN or attackers:
            return
        attackers.append(Attacker(node, case))
        wait_until(lambda: not attackers[0].missing())
        odd_requests(node, started)
        for ahead in range(30):
            attackers[0].forge(tick + ahead)
            attackers[0].publish(*attackers[0].hostile())
        for publisher in attackers[0].publishers.values():  # who leaves takes no more than what is there
            assert publisher.wait_for_all_acked(Duration(seconds=LOADED_S)), publisher.topic_name
        asked.append(client(Trigger, "/plant_sim/resume", Trigger.Request()).success)

    with somebody("attacker") as (node, _):
        outcome = graph.run(case, "lockstep", tmp_path, quiet, LOADED_S, look=look)
    recorded = load(outcome.recording)
    assert asked == [True] * 3
    assert set(attackers[0].sent) >= set(LATEST)
    assert_same(recorded, loop.run(case))
    assert_all_refused(attackers[0].sent, outcome, recorded)


def test_flood_costs_time_and_is_told_and_nothing_else(domain: int, tmp_path: Path) -> None:
    """In real time. On a slow machine a device may be released, and a recorder may lose messages; both are reported."""
    case = load_case(None, [*SETS, "duration=5"])
    with somebody("attacker") as (node, _):
        attackers: list[Attacker] = []

        def flood(done: int, _of: int) -> None:
            if done < case.run.frame_rate or attackers:
                return
            attacker = Attacker(node, case)
            attackers.append(attacker)
            wait_until(lambda: not attacker.missing())
            odd = [attacker.hostile() for _ in range(100)] + [
                (topic, make(done)) for topic, make in attacker.forged
            ] * 10
            for topic, data in itertools.islice(itertools.cycle(odd), FLOOD):
                with suppress(rclpy_implementation.RCLError):  # too many at once
                    attacker.publish(topic, data)

        outcome = graph.run(case, "realtime", tmp_path, flood, LOADED_S)
    record, computed, sent = load(outcome.recording), loop.run(case), attackers[0].sent.total()
    summary = summarise(record)
    assert sent > FLOOD / 2
    assert sum(outcome.messages_refused.values()) > sent / 2
    assert {cause for _, cause, _, _ in outcome.messages_refused} == {"publisher"}
    assert outcome.fallen == []
    if not record.notes:
        assert len(record.time_ns) == case.ticks
        assert set(record.applied["value"].tolist()) <= set(record.issued["value"].tolist())
    if not summary.releases:
        assert summary.stable == summarise(computed).stable
