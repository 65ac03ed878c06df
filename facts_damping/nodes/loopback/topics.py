"""Topics of a loopback: messages go from publishers to readers as bytes, at once.

As with DDS, ends meet whose qualities of service fit, a reader has a queue of its own, and who comes late hears of
transient local topics what its publisher keeps.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as real

from facts_damping.nodes.loopback.domain import Destroyable, domain
from facts_damping.nodes.loopback.processes import wall_ns

if TYPE_CHECKING:
    from facts_damping.nodes.loopback.domain import Node

KEEP_ALL, RELIABLE, TRANSIENT_LOCAL = 2, 1, 1  # of rmw/types.h


class End(Destroyable):
    """What publishers and subscriptions have in common."""

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: Any) -> None:
        super().__init__()
        self.node, self.kind, self.topic, self.qos = node, kind, node.resolve(topic), qos.to_dict()
        self.identity = node.identity_of_an_end()

    def get_topic_name(self) -> str:
        return self.topic

    def get_logger_name(self) -> str:
        return self.node.logger_name()

    def transient(self) -> bool:
        """Whether late ones hear what was."""
        return int(self.qos["durability"]) == TRANSIENT_LOCAL

    def queue(self) -> deque[Any]:
        """Room for as many messages as are kept."""
        every = int(self.qos["history"]) == KEEP_ALL
        return deque(maxlen=None if every else max(1, int(self.qos["depth"])))

    def described(self, endpoint_type: int) -> dict[str, Any]:
        """Its description, as `rclpy.topic_endpoint_info` has it."""
        module = self.kind.__module__.split(".")
        return {
            "node_name": self.node.get_node_name(),
            "node_namespace": self.node.get_namespace(),
            "topic_type": f"{module[0]}/{module[1]}/{self.kind.__name__}",
            "topic_type_hash": {"version": -1, "value": b"\0" * 32},
            "endpoint_type": endpoint_type,
            "endpoint_gid": list(self.identity),
            "qos_profile": self.qos,
        }


def fit(publisher: End, subscription: End) -> bool:
    """Whether two ends meet: a reader wants no more than is offered."""
    if publisher.topic != subscription.topic or publisher.kind is not subscription.kind:
        return False
    reliable = int(publisher.qos["reliability"]) == RELIABLE or int(subscription.qos["reliability"]) != RELIABLE
    return reliable and (publisher.transient() or not subscription.transient())


class Publisher(End):
    """Sends messages to all that read its topic."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._count, self._kept = 0, self.queue()
        domain().publishers.append(self)

    def publish(self, message: Any) -> None:
        self.publish_raw(real.rclpy_serialize(message, self.kind))

    def publish_raw(self, data: bytes) -> None:
        self._count += 1
        now = wall_ns()
        information = {
            "source_timestamp": now,
            "received_timestamp": now,
            "publication_sequence_number": self._count,
            "reception_sequence_number": None,
            "publisher_gid": {"implementation_identifier": "loopback", "data": self.identity},
        }
        if self.transient():
            self._kept.append((bytes(data), information))
        for one in domain().subscriptions:
            if fit(self, one):
                one.waiting.append((bytes(data), information))

    def repeat_for(self, subscription: Subscription) -> None:
        """What a reader that comes late hears."""
        subscription.waiting.extend(self._kept if subscription.transient() else ())

    def get_subscription_count(self) -> int:
        return sum(fit(self, one) for one in domain().subscriptions)

    def wait_for_all_acked(self, _timeout: Any) -> bool:
        return True


class Subscription(End):
    """A queue of messages."""

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: Any, _filter: Any = None) -> None:
        super().__init__(node, kind, topic, qos)
        self.waiting = self.queue()
        for publisher in domain().publishers:
            if fit(publisher, self):
                publisher.repeat_for(self)
        domain().subscriptions.append(self)

    def take_message(self, kind: type[Any], raw: bool) -> tuple[Any, dict[str, Any]] | None:
        if not self.waiting:
            return None
        data, information = self.waiting.popleft()
        return (data if raw else real.rclpy_deserialize(data, kind)), information

    def get_publisher_count(self) -> int:
        return sum(fit(one, self) for one in domain().publishers)

    def is_ready(self) -> bool:
        """Whether there is something to take."""
        return bool(self.waiting)
