"""Foreign and faulty messages have no effect, end no node, and are counted."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from facts_damping_msgs.msg import DeviceSetpoints, JacobianEstimate, PmuDataFrame, RunState
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message

from facts_damping.case.loading import load_case
from facts_damping.cli.main import DEGRADED, main
from facts_damping.nodes.admission.message_filter import MessageFilter
from facts_damping.nodes.admission.publishers import KNOW_S, Reading
from facts_damping.nodes.admission.refusals import MAXIMUM, TELL_S
from facts_damping.nodes.base.parameters import Options
from facts_damping.nodes.base.qos import SUBSCRIBER_QOS
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.nodes.transport.messages import Estimates, stamped
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.signals import DELIVERY, SETPOINT
from facts_damping_testing.foreign.messages import hostile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rclpy.node import Node

CASE = load_case(None, ["controllers.0.name=HBsWC", "controllers.0.scheme=indirect"])
OWN = bytes(range(16))
FOREIGN = bytes(range(16, 32))
OTHER = bytes(range(32, 48))
PLANT = bytes(range(48, 64))


@pytest.fixture
def node(domain: int) -> Iterator[Node]:
    rclpy.init()
    created = rclpy.create_node("guarded", parameter_overrides=[Parameter("progress", value=True)])
    yield created
    created.destroy_node()
    rclpy.shutdown()


def information(publisher: bytes, sequence: int | None) -> dict[str, Any]:
    return {"publisher_gid": {"data": publisher}, "publication_sequence_number": sequence}


def options(realtime: bool, join: bool = False) -> Options:
    return Options("realtime" if realtime else "lockstep", 5.0, 30.0, recorder=False, view=False, join=join)


class Listener:
    """A message filter with a topic whose publisher it knows, and the admitted messages."""

    def __init__(
        self, node: Node, read: Callable[[bytes], Any], realtime: bool = False, newest: Callable[[], int] | None = None
    ) -> None:
        self.admitted: list[Any] = []
        self.reports: list[bytes] = []
        self.message_filter = MessageFilter(node, CASE, options(realtime), send_refusals=self.reports.append)
        self.message_filter.subscribe(
            PmuDataFrame, "topic", lambda *message: self.admitted.append(message), Reading(read, newest)
        )
        (self.state,) = self.message_filter.senders.topics
        self.state.publisher = OWN
        self.sent = 0

    def send(self, data: bytes, publisher: bytes = OWN, sequence: int | None = None) -> bool:
        self.sent += 1
        return self.message_filter.take(self.state, data, information(publisher, sequence or self.sent))

    def causes(self) -> list[str]:
        return [cause for (_, cause, _), count in self.message_filter.refusals._refused.items() for _ in range(count)]


def ticks(data: bytes) -> tuple[int]:
    return (int(data),)


def test_ticks_come_one_after_the_other(node: Node) -> None:
    listener = Listener(node, ticks)
    assert [listener.send(str(tick).encode()) for tick in (0, 1, 1, 3, 2, 10**9, 3)] == [
        *(True, True, False, False, True, False, True)
    ]
    assert listener.causes() == ["tick"] * 3


def test_publisher_that_does_not_begin_with_tick_0_is_foreign(node: Node) -> None:
    listener = Listener(node, ticks)
    assert [
        listener.send(b"5", FOREIGN),
        listener.send(b"5"),
        listener.send(b"0"),
        listener.send(b"1", FOREIGN),
        listener.send(b"1"),
    ] == [*(False, False, True, False, True)]
    assert listener.causes() == ["publisher"] * 3


def test_in_real_time_ticks_may_be_missing_as_the_clock_allows(node: Node) -> None:
    listener = Listener(node, ticks, realtime=True)
    assert listener.send(b"0")
    assert not listener.send(b"1000")
    assert listener.send(b"60")
    listener.state.at -= 60.0
    assert listener.send(b"1000")
    assert not listener.send(b"1000")


def test_answer_before_its_tick_is_refused(node: Node) -> None:
    listener = Listener(node, ticks, newest=lambda: 0)
    assert [listener.send(b"0"), listener.send(b"1")] == [True, False]


def test_message_of_another_publisher_or_old_sequence_is_refused(node: Node) -> None:
    listener = Listener(node, ticks)
    assert listener.send(b"0", OWN, 5)
    assert not listener.send(b"1", FOREIGN, 6)
    assert not listener.send(b"1", OWN, 5)
    assert listener.send(b"1", OWN, 6)
    assert sorted(listener.causes()) == ["publisher", "sequence"]
    for i in range(2 * MAXIMUM):
        listener.send(b"2", i.to_bytes(16, "big"))
    assert len(listener.message_filter.refusals._refused) <= MAXIMUM + 1
    assert listener.message_filter.refusals._refused.total() == 2 * MAXIMUM + 2


def sound(data: bytes) -> tuple[int]:
    if not data.isdigit():
        raise Refused("format")
    return (int(data),)


@pytest.mark.parametrize(
    ("realtime", "there", "plant", "succeeds"),
    [
        (True, [FOREIGN], [PLANT], True),
        (True, [OWN, FOREIGN], [PLANT], False),
        (True, [FOREIGN, OTHER], [PLANT], False),
        (False, [FOREIGN], [PLANT], False),
        (True, [FOREIGN], [], False),  # the run is over
        (True, [FOREIGN], [FOREIGN], False),
    ],
)
def test_place_of_one_that_has_left_is_free_in_real_time(
    node: Node, realtime: bool, there: list[bytes], plant: list[bytes], succeeds: bool
) -> None:
    listener = Listener(node, sound, realtime)
    listener.message_filter.subscribe_run_state()
    listener.message_filter.senders.topics[1].publisher = PLANT
    listener.message_filter.senders.of = lambda topic: plant if topic == "/plant/state" else there  # type: ignore[method-assign]
    assert listener.send(b"0")
    assert not listener.send(b"odd", FOREIGN)
    time.sleep(2 * KNOW_S)
    assert listener.send(b"1")
    assert listener.send(b"2", FOREIGN) == succeeds
    assert listener.send(b"3" if succeeds else b"2") != succeeds
    assert listener.causes() == ["format" if succeeds else "publisher", "publisher"]


def test_joining_node_is_heard_first_on_topics_common_to_all_nodes(node: Node) -> None:
    """As a disarmed identifier, which the recording must name."""
    listener = Listener(node, ticks, realtime=True)
    admitted: list[bytes] = []
    listener.message_filter.subscribe(
        DiagnosticArray, "/diagnostics", lambda data, _: admitted.append(data), common=True
    )
    state = listener.message_filter.senders.topics[1]
    for there, data in (([OWN], b"a"), ([FOREIGN], b"b")):
        listener.message_filter.senders.of = lambda _, there=there: there  # type: ignore[method-assign, misc]
        listener.message_filter.take(state, data, information(FOREIGN[:12] + bytes(4), len(admitted) + 1))
        time.sleep(2 * KNOW_S)
    assert admitted == [b"b"]


def test_plant_cannot_be_replaced_by_another_publisher(node: Node) -> None:
    listener = Listener(node, ticks, realtime=True)
    listener.message_filter.subscribe_run_state()
    listener.message_filter.senders.topics[1].publisher = OWN[:12] + bytes(4)
    listener.message_filter.senders.of = lambda topic: [OWN[:12] + bytes(4)] if topic == "/plant/state" else [FOREIGN]  # type: ignore[method-assign]
    assert listener.send(b"0")
    assert not listener.send(b"1", FOREIGN)


def test_run_state_of_others_than_the_plant_is_ignored(node: Node, capsys: Any) -> None:
    listener = Listener(node, ticks)
    listener.message_filter.subscribe_run_state()
    _, plant, state = listener.message_filter.senders.topics
    plant.publisher = PLANT
    ended = RunState(state=RunState.ENDED, tick=300, reason="synchronism lost at 5.000 s", in_synchronism=False)
    message = serialize_message(stamped(ended, 5 * 10**9))
    for publisher, let in ((FOREIGN, False), (PLANT[:12] + bytes(4), True)):
        assert listener.message_filter.take(state, message, information(publisher, 1)) == let
        assert listener.message_filter.over == let
    assert capsys.readouterr().out == "synchronism lost at 5.000 s\n"
    assert listener.causes() == []


def test_reports_come_at_most_once_a_second(node: Node, capsys: Any) -> None:
    listener = Listener(node, ticks)
    listener.send(b"0")
    listener.message_filter.report_refusals()
    listener.send(b"9999999")
    listener.message_filter.report_refusals()
    assert listener.reports == []
    listener.message_filter.refusals._reported_at -= TELL_S
    for _ in range(3):
        listener.message_filter.report_refusals()
    listener.send(b"9999999")
    listener.message_filter.report_refusals()
    assert len(listener.reports) == 1
    assert capsys.readouterr().out == f"refused 1 tick /topic {OWN.hex()}\n"
    listener.message_filter.report_refusals(last=True)
    assert len(listener.reports) == 2
    assert capsys.readouterr().out == f"refused 2 tick /topic {OWN.hex()}\n"


def test_odd_messages_of_the_known_publisher_are_refused_too(node: Node) -> None:
    rng = np.random.default_rng(1)
    rows, setpoints = np.zeros(1, DELIVERY), np.zeros(1, SETPOINT)
    readers: list[tuple[type[Any], Any, list[bytes]]] = [
        (PmuDataFrame, FramesMessage(CASE), [FramesMessage(CASE).fill(0, 0, rows, 1)]),
        (DeviceSetpoints, SetpointsMessage(CASE), [SetpointsMessage(CASE).fill(0, 0, setpoints, "")]),
        (JacobianEstimate, Estimates(CASE, 0), []),
    ]
    for kind, reader, genuine in readers:
        listener = Listener(node, reader.read)
        for _ in range(1000):
            listener.send(hostile(rng, kind, genuine))
        assert len(listener.causes()) + len(listener.admitted) == listener.sent
        assert {"format", "names"} <= set(listener.causes())
        assert len(listener.admitted) <= 5
        assert [message[0] for message in listener.admitted] == list(range(len(listener.admitted)))


def test_forged_message_is_reported_at_the_end_of_a_command(loopback: Any, tmp_path: Path, capsys: Any) -> None:
    def forge() -> None:
        rclpy.init()
        time.sleep(1.0)  # the graph is under way
        publisher = rclpy.create_node("attacker").create_publisher(PmuDataFrame, "pmu/frames", SUBSCRIBER_QOS)
        assert publisher.get_subscription_count() == 2
        publisher.publish(PmuDataFrame(tick=10**9))
        time.sleep(9.0)

    loopback.start("attacker", forge)
    status = main(["run", "--mode", "realtime", "--set", "duration=3", "--out", str(tmp_path), "--json", "-"])
    output, errors = capsys.readouterr()
    assert status == DEGRADED
    assert errors == "facts-damping: the run ended, but: refused messages: 2 by publisher\n"
    rows = json.loads(output)["refused_messages"]
    assert sorted((row["node"], row["cause"], row["topic"], row["count"]) for row in rows) == [
        ("/recorder", "publisher", "/pmu/frames", 1),
        ("/wan_link", "publisher", "/pmu/frames", 1),
    ]
