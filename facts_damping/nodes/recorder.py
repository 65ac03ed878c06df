"""recorder: writes every topic of the graph as it is, raw CDR, to an MCAP recording."""

from __future__ import annotations

import platform
import sys
import time
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import facts_damping_msgs.msg as messages
from diagnostic_msgs.msg import DiagnosticArray

from facts_damping.case.names import controller_addresses, identifier_addresses, link_addresses
from facts_damping.nodes.cdr import Refused
from facts_damping.nodes.guard import TOPIC as REFUSED
from facts_damping.nodes.guard import Guard
from facts_damping.nodes.messages import errors
from facts_damping.nodes.node import COMMON, run_node
from facts_damping.nodes.parameters import descriptor, read_case, read_options
from facts_damping.nodes.spinning import HEARD_S, Spinner, told_to_stop
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.simulated import stamp_ns
from facts_damping.recording.writer import RecordingWriter
from facts_damping.version import __version__

if TYPE_CHECKING:
    from rclpy.node import Node

    from facts_damping.case.model import Case

FLUSH_S = 0.5  # wall time after which the chunk in progress goes to disk: the most that a kill can cost
QUIET_S = 0.2  # wall time without a message after which a stopped recorder is done
POLL_S = 0.01  # wall time between two looks at the queues

TOPICS = {
    "pmu/frames": messages.PmuDataFrame,
    "plant/state": messages.PlantState,
    "plant/events": messages.GridEvent,
    "/diagnostics": DiagnosticArray,
    REFUSED: messages.RefusedMessages,
}
OF_A_LINK = {
    "pmu/delivered": messages.PmuDataFrame,
    "setpoints/delivered": messages.VoltageSetpoints,
    "link/statistics": messages.LinkStatistics,
}
OF_A_CONTROLLER = {"setpoints": messages.VoltageSetpoints, "state": messages.ControllerState}


STAMP_END = 12  # bytes that a message has at least
UNTICKED = ("plant/events", "link/statistics", "/diagnostics", REFUSED)  # not begun at tick 0


def begins_a_run(data: bytes) -> bool:
    """Whether a message is of tick 0, or of what was measured until then."""
    return len(data) >= STAMP_END and stamp_ns(data) <= 0


def topics(case: Case) -> dict[str, Any]:
    """Topics of a case and their types."""
    own = {link.topic(name): kind for link in link_addresses(case) for name, kind in OF_A_LINK.items()}
    own |= {f"{one}/{name}": kind for one in controller_addresses(case) for name, kind in OF_A_CONTROLLER.items()}
    own |= {f"{one}/estimate": messages.JacobianEstimate for one in identifier_addresses(case).values()}
    return {**TOPICS, **own}


def message_type(kind: Any) -> str:
    """Name of a class of messages: `std_msgs/msg/Header`."""
    package, _, module = kind.__module__.partition(".")
    return f"{package}/{module.split('.')[0]}/{kind.__name__}"


def versions() -> dict[str, str]:
    """What a recording was made with."""
    found = {"facts_damping": __version__, "python": platform.python_version()}
    for package in ("numpy", "scipy", "numba", "mcap", "rclpy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not a pip package"
    return found


class Recorder:
    """Subscribes to everything and writes it."""

    def __init__(self, node: Node) -> None:
        """Read parameters, open the recording, subscribe."""
        self.case, self.options = read_case(node), read_options(node, joins=False)
        folder: Any = node.declare_parameter("output", "recording", descriptor("folder of the new recording")).value
        self.writer = RecordingWriter(folder, dump(self.case.document()), versions())
        self.taken: list[tuple[int, int, str, bytes]] = []  # source's time, sequence, topic, data
        self.refused = node.resolve_topic_name(REFUSED)
        self.guard = Guard(node, self.case, self.options, say=self.on_refused)
        begins = begins_a_run if self.options.recorder else None  # others wait for it: it hears all from the first on
        for topic, kind in topics(self.case).items():
            name = node.resolve_topic_name(topic)
            self.writer.add_topic(name, message_type(kind))
            use, unticked = partial(self.on_message, name), topic.endswith(UNTICKED)
            self.guard.subscribe(kind, topic, use, begins=None if unticked else begins, common=unticked)
        self.guard.know_plant()
        self.spinner = Spinner(node, self.guard)

    def on_refused(self, data: bytes) -> None:
        """Keep what the recorder itself has refused."""
        self.taken.append((time.time_ns(), 0, self.refused, data))

    def on_message(self, topic: str, data: bytes, information: dict[str, Any]) -> None:
        """Take one message."""
        self.taken.append((information["source_timestamp"], information["publication_sequence_number"], topic, data))
        if topic == COMMON and self.guard.is_plant(information["publisher_gid"]["data"]):
            with suppress(Refused):
                self.guard.repeat(*errors(data))

    def take(self) -> bool:
        """Take what has come and write it; whether there may be more."""
        more = self.spinner.take_all()
        self.write()
        return more

    def write(self) -> None:
        """Write what was taken, in the order in which it was published."""
        for source_ns, sequence, topic, data in sorted(self.taken):
            self.writer.write(topic, data, time.time_ns(), source_ns, sequence)
        self.taken.clear()

    def run(self) -> None:
        """Record until a signal, and then until nothing more comes; what was published by then is written."""
        try:
            self.drain()
        finally:
            self.guard.tell(last=True)
            self.write()
            lost = {f"{topic} {publisher}": count for (topic, publisher), count in self.guard.lost().items()}
            self.writer.close(lost)
        sys.stdout.write(f"lost {sum(lost.values())}\n")
        sys.stdout.flush()

    def drain(self) -> None:
        """Empty the queues, rest, and flush by the clock; told to stop, until nothing comes, for a while at most."""
        flushed = told = time.monotonic()
        while not told_to_stop() or (
            time.monotonic() - self.guard.heard < QUIET_S and time.monotonic() - told < HEARD_S
        ):
            more = self.take()
            if time.monotonic() - flushed > FLUSH_S:
                self.writer.flush()
                flushed = time.monotonic()
            if not told_to_stop():
                told = time.monotonic()
            if not more:
                time.sleep(POLL_S)


def main() -> None:
    """Entry point of `ros2 run facts_damping recorder`."""
    run_node("recorder", Recorder)


if __name__ == "__main__":
    main()
