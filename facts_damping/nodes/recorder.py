"""recorder: writes every topic of the graph as raw CDR to an MCAP recording."""

from __future__ import annotations

from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import facts_damping_msgs.msg as messages
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from facts_damping.case.names import (
    SUPERVISED,
    controller_addresses,
    identifier_addresses,
    link_addresses,
    setpoint_topics,
    supervisor_addresses,
)
from facts_damping.control.table import kind_of
from facts_damping.nodes import clock
from facts_damping.nodes.admission.member import RECORDER, Member
from facts_damping.nodes.admission.publishers import Reading
from facts_damping.nodes.base import lines
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case, read_options
from facts_damping.nodes.base.qos import LATCHED_SUBSCRIBER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import DRAIN_S, BeginAgain, stop_requested
from facts_damping.nodes.base.topics import CHANGES, DIAGNOSTICS, FRAMES, PLANT_STATE, REFUSALS, RUN_STATE
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.nodes.transport.messages import Health, run_state
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.columns import stamp_ns
from facts_damping.recording.writer import RecordingWriter
from facts_damping.version import versions

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.case.model import Case
    from facts_damping.nodes.base.managed import ManagedNode

FLUSH_S = 0.5  # wall time between two flushes of the current chunk to disk: the most data that a kill can lose
QUIET_S = 0.2  # wall time without a message after which a stopped recorder is done
BEHIND_S = 10.0  # longest wall time that a stopped recorder spends on queued messages, such as a refused flood
REPORT_S = 1.0  # wall time between two diagnostics
POLL_S = 0.02  # wall time between two polls of the queues

TOPICS = {
    FRAMES: messages.PmuDataFrame,
    PLANT_STATE: messages.PlantState,
    "plant/events": messages.GridEvent,
    DIAGNOSTICS: DiagnosticArray,
    REFUSALS: messages.RefusedMessages,
    CHANGES: messages.RunChange,
    RUN_STATE: messages.RunState,
}
STAMP_END, TICK_END = 12, 20  # byte offsets: end of the header's stamp; end of its empty frame_id
NO_FRAME = b"\1\0\0\0\0"  # followed by three bytes of padding with any value
UNTICKED = ("plant/events", "link/statistics", DIAGNOSTICS, REFUSALS, CHANGES, RUN_STATE)  # not begun at tick 0
LATE = (CHANGES, RUN_STATE)  # earlier messages are received, too


def begins_a_run(check: Callable[[bytes], Any] | None, data: bytes) -> bool:
    """Whether a message that begins with header and tick is of tick 0, and not refused by `check`, if there is one."""
    if not data[STAMP_END:].startswith(NO_FRAME) or int.from_bytes(data[TICK_END : TICK_END + 8], "little") != 0:
        return False
    with suppress(Refused):
        return check is None or check(data) is not None
    return False


def topics(case: Case) -> dict[str, Any]:
    """Topics of a case and their message classes."""
    kinds: dict[str, Any] = {}
    for link in link_addresses(case):
        kinds[link.topic("pmu/delivered")] = messages.PmuDataFrame
        kinds[link.topic("setpoints/delivered")] = messages.DeviceSetpoints
        kinds[link.topic("link/statistics")] = messages.LinkStatistics
    for controller, address in zip(case.controllers, controller_addresses(case), strict=True):
        kinds[f"{address}/setpoints"] = messages.DeviceSetpoints
        if not kind_of(controller).node:  # a user's own node need not publish its state
            kinds[f"{address}/state"] = messages.ControllerState
    for address in identifier_addresses(case).values():
        kinds[f"{address}/estimate"] = messages.JacobianEstimate
    for address in supervisor_addresses(case).values():
        kinds[f"{address}/{SUPERVISED}"] = messages.DeviceSetpoints
        kinds[f"{address}/state"] = messages.SupervisorState
    return TOPICS | kinds


def message_type(kind: Any) -> str:
    """ROS name of a message class, such as `std_msgs/msg/Header`."""
    package, _, module = kind.__module__.partition(".")
    return f"{package}/{module.split('.')[0]}/{kind.__name__}"


class Recorder:
    """Subscribes to all topics and writes the messages."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options = read_case(node), read_options(node, joins=False)
        self.folder: str = declare(node, "output", "recording", descriptor("folder of the new recording"))
        self.received: list[tuple[int, int, str, bytes]] = []  # source timestamp in ns, sequence number, topic, data
        self.refused, self.run_state = (node.resolve_topic_name(name) for name in (REFUSALS, RUN_STATE))
        send = self.on_refused
        self.member = Member(node, self.case, self.options, RECORDER, hardware=self.folder, send_refusals=send)
        self.message_filter, self.clock = self.member.message_filter, node.resolve_topic_name(PLANT_STATE)
        waited = self.options.recorder and not self.options.free  # others wait for it: it gets all first messages
        self.topics: dict[str, str] = {}
        # Topics of one publisher first: they tell which nodes are the graph's.
        for topic, kind in sorted(topics(self.case).items(), key=lambda pair: pair[0].endswith(UNTICKED)):
            name, unticked = node.resolve_topic_name(topic), topic.endswith(UNTICKED)
            self.topics[name] = message_type(kind)
            qos = LATCHED_SUBSCRIBER_QOS if topic in LATE else SUBSCRIBER_QOS
            use = partial(self.on_message, name)
            check = self.check(kind, topic)
            begins = partial(begins_a_run, check) if waited and not unticked else None
            reading = Reading(begins=begins, check=check)
            self.message_filter.subscribe(kind, topic, use, reading, common=unticked, qos=qos)
        self.message_filter.senders.know_plant()
        self.written = 0
        self.spinner = self.member.spin()

    def check(self, kind: Any, topic: str) -> Callable[[bytes], Any] | None:
        """A function that refuses a message of a signed topic that is not signed by this graph; None: not signed."""
        seal, of = self.member.seal(topic), setpoint_topics(self.case).get(topic)
        if seal is None or (of is None and kind is not messages.PmuDataFrame):
            return None
        return (FramesMessage(self.case, seal) if of is None else SetpointsMessage(self.case, *of, seal)).read

    def ready(self) -> None:
        """Open the recording."""
        self.member.log_started()
        endless = {} if self.options.ends(self.case) else {"duration": None}
        self.writer = RecordingWriter(self.folder, dump(self.case.document() | endless), versions("mcap", "rclpy"))
        for name, kind in self.topics.items():
            self.writer.add_topic(name, kind)

    def on_refused(self, data: bytes) -> None:
        """Keep the recorder's own report of refusals for the recording."""
        self.received.append((clock.time_ns(), 0, self.refused, data))

    def on_message(self, topic: str, data: bytes, information: dict[str, Any]) -> None:
        """Keep one message for the recording."""
        sequence = information["publication_sequence_number"] or 0  # not every middleware numbers messages
        self.received.append((information["source_timestamp"], sequence, topic, data))
        if topic == self.clock and len(data) >= STAMP_END:
            self.member.at_ns = stamp_ns(data)
        if topic == self.run_state and self.message_filter.senders.is_plant(information["publisher_gid"]["data"]):
            with suppress(Refused):
                self.message_filter.on_run(*run_state(data))

    def record_waiting(self) -> bool:
        """Take the queued messages and write them. Returns whether there may be more."""
        more = self.spinner.take_all()
        self.write()
        return more

    def write(self) -> None:
        """Write the taken messages in the order of their publication."""
        for source_ns, sequence, topic, data in sorted(self.received):
            self.writer.write(topic, data, clock.time_ns(), source_ns, sequence)
        self.written += len(self.received)
        self.received.clear()

    def health(self) -> Health:
        """Numbers of messages written and lost."""
        lost = sum(self.message_filter.lost().values())
        text = f"{self.written} messages written" + (f", {lost} lost" if lost else "")
        values = {"mode": self.options.mode, "written": self.written, "lost": lost}
        return Health(DiagnosticStatus.WARN if lost else DiagnosticStatus.OK, text, values)

    def run(self) -> None:
        """Record until a signal or the end of the run, then until no more messages come; close the recording."""
        try:
            self.drain()
        except BeginAgain:
            self.message_filter.log.warning("another plant has started: the recording ends here")
        finally:
            self.message_filter.report_refusals(last=True)
            self.write()
            lost = {f"{topic} {publisher}": count for (topic, publisher), count in self.message_filter.lost().items()}
            self.writer.close(lost, self.message_filter.publishers())
        self.message_filter.log.line(lines.lost_line(sum(lost.values())))
        self.message_filter.log.info(f"{self.folder}: {self.health().message}")

    def drain(self) -> None:
        """Poll the queues and flush periodically; after a stop signal, until the queues are empty or time is up."""
        flushed = reported = clock.monotonic()
        noted_s: float | None = None  # when the stop signal was noted
        while True:
            stopping = stop_requested()  # asked before the queues are read: what has come by then is recorded
            more, now = self.record_waiting(), clock.monotonic()
            if now - flushed > FLUSH_S:
                self.writer.flush()
                flushed = now
            if now - reported > REPORT_S and self.member.at_ns:  # the time comes from the plant
                self.member.publish(self.health())
                reported = now
            quiet = now - self.message_filter.admitted_at >= QUIET_S
            noted_s = now if stopping and noted_s is None else noted_s
            if noted_s is not None and now - noted_s >= (BEHIND_S if more else 0.0 if quiet else DRAIN_S):
                break
            if self.message_filter.done():
                break
            if not more:
                clock.sleep(POLL_S)


main = partial(
    run_node, "recorder", Recorder, "The recorder: writes every topic of the graph as it is, raw CDR, to MCAP."
)
