"""Refusals of a node: counted by topic, cause and source; logged and published at most once per second."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from facts_damping_msgs.msg import RefusedCount, RefusedMessages
from rclpy.serialization import serialize_message

from facts_damping.nodes import clock
from facts_damping.nodes.base import lines
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.topics import REFUSALS
from facts_damping.nodes.transport.messages import stamped

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

TELL_S = 1.0  # minimum wall time between two reports
MAXIMUM = 200  # separate counts by topic, cause and publisher; further publishers are counted together as others
OTHERS = b""
REMARKS = {
    "publisher": "of others were refused: another graph in this ROS_DOMAIN_ID (0 to 101)?",
    "session": "of another session were refused: do the clocks of the hosts agree?",
}  # by cause of refusal, for an error
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # the middleware's name of a node that it has not discovered yet


class Refusals:
    """Counts and reports the refusals of a node."""

    def __init__(self, node: Node, graph: str, send: Callable[[bytes], None] | None, *, peer: bool = True) -> None:
        """`graph`, `send`, `peer`: as in MessageFilter."""
        self._node, self._log, self._send = node, NodeLog(node), send
        if peer:  # others recognise a peer by this publisher
            publisher = node.create_publisher(RefusedMessages, f"{graph}{REFUSALS}", PUBLISHER_QOS)
            self._send = send or publisher.publish
        self._refused: Counter[tuple[str, str, bytes]] = Counter()  # by topic, cause, publisher
        self._reported: Counter[tuple[str, str, str]] = Counter()  # by topic, cause, source
        self._sources = {OTHERS: "others"}  # reported source, by refused publisher
        self._reported_at = 0.0

    def add(self, topic: str, cause: str, publisher: bytes = OTHERS) -> None:
        """Count a refused message or request."""
        if not self._refused:
            self._reported_at = clock.monotonic()  # report later: the name of a new node is not known yet
        if len(self._refused) < MAXIMUM or (topic, cause, publisher) in self._refused:
            self._refused[topic, cause, publisher] += 1
        else:
            self._refused[topic, cause, OTHERS] += 1

    def report(self, at_ns: int, last: bool = False) -> None:
        """Report new refusals as lines `refused N CAUSE TOPIC SOURCE` and a message; at once at the `last` call.

        `at_ns`: start of the newest tick.
        """
        if self._reported.total() == self._refused.total() or not (
            last or clock.monotonic() - self._reported_at > TELL_S
        ):
            return
        self._reported_at = clock.monotonic()
        counts: Counter[tuple[str, str, str]] = Counter()
        for (topic, cause, publisher), count in self._refused.items():
            counts[topic, cause, self._source(topic, publisher)] += count
        for (topic, cause, source), count in counts.items():
            if count != self._reported[topic, cause, source]:
                self._log.line(lines.refused_line(count, cause, topic, source))
                if (topic, cause, source) not in self._reported:  # log only the first; the total is logged at the end
                    self._log.warning(f"refused a message on {topic} from {source}: {cause}")
        if last:
            self._log.warning(f"refused {counts.total()} messages in all")
        self._reported = counts
        if self._send is None:
            return
        message = RefusedMessages(node=self._node.get_fully_qualified_name())
        message.refused = [
            RefusedCount(topic=topic, cause=cause, source=source, count=count)
            for (topic, cause, source), count in counts.items()
        ]
        self._send(serialize_message(stamped(message, at_ns)))

    def _source(self, topic: str, publisher: bytes) -> str:
        """Reported source of a publisher, cached: its node's full name, else its identity."""
        if publisher not in self._sources:
            self._sources[publisher] = node_name(self._node, topic, publisher) or publisher.hex()
        return self._sources[publisher]

    def remark(self) -> str:
        """Text to append to an error: a peer that seems silent may be one whose messages were refused; else empty."""
        counts = Counter[str]()
        for (_, cause, _), count in self._refused.items():
            counts[cause] += count
        return "".join(f"; {counts[cause]} messages {text}" for cause, text in REMARKS.items() if counts[cause])


def node_name(node: Node, topic: str, publisher: bytes) -> str:
    """Full name of the node of a topic's publisher; empty if it is not known yet or has left."""
    publishers = node.get_publishers_info_by_topic(topic)
    endpoint = next((candidate for candidate in publishers if bytes(candidate.endpoint_gid) == publisher), None)
    if endpoint is None or endpoint.node_name == UNKNOWN:
        return ""
    name = f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
    return "".join(c if c.isprintable() and not c.isspace() else "?" for c in name)
