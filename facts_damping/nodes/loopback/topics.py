"""Topics of a loopback: messages go from publishers to subscriptions at once, as bytes.

As with DDS, qualities of service must fit, each subscription has a queue, and a late one receives what the publisher of
a transient local topic keeps.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as real

from facts_damping.nodes.loopback.domain import GID_TAIL, Endpoint, domain
from facts_damping.nodes.loopback.processes import wall_ns

if TYPE_CHECKING:
    from facts_damping.nodes.loopback.domain import Node

KEEP_ALL, RELIABLE, TRANSIENT_LOCAL = 2, 1, 1  # of rmw/types.h


class TopicEndpoint(Endpoint):
    """A publisher or a subscription."""

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: Any) -> None:
        super().__init__(node, kind, topic, qos.to_dict())
        self.identity = node.identity + next(node.ends).to_bytes(GID_TAIL, "big")
        self.latched = int(self.qos["durability"]) == TRANSIENT_LOCAL
        keeps_all = int(self.qos["history"]) == KEEP_ALL
        self.waiting = deque(maxlen=None if keeps_all else max(1, int(self.qos["depth"])))

    def get_topic_name(self) -> str:
        return self.name

    def described(self, endpoint_type: int) -> dict[str, Any]:
        """Fields of `rclpy.topic_endpoint_info`."""
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


def fit(publisher: TopicEndpoint, subscription: TopicEndpoint) -> bool:
    """Whether a subscription receives from a publisher: same topic, and no better quality requested than offered."""
    if publisher.name != subscription.name or publisher.kind is not subscription.kind:
        return False
    reliable = int(publisher.qos["reliability"]) == RELIABLE or int(subscription.qos["reliability"]) != RELIABLE
    return reliable and (publisher.latched or not subscription.latched)


class Publisher(TopicEndpoint):
    """Sends messages to all subscriptions of its topic; its queue has those that it keeps for late ones."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._count = 0
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
        if self.latched:
            self.waiting.append((bytes(data), information))
        for one in domain().subscriptions:
            if fit(self, one):
                one.waiting.append((bytes(data), information))

    def get_subscription_count(self) -> int:
        return sum(fit(self, one) for one in domain().subscriptions)

    def wait_for_all_acked(self, _timeout: Any) -> bool:
        return True


class Subscription(TopicEndpoint):
    """A queue of messages."""

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: Any, _filter: Any = None) -> None:
        super().__init__(node, kind, topic, qos)
        for publisher in domain().publishers if self.latched else ():
            if fit(publisher, self):
                self.waiting.extend(publisher.waiting)
        domain().subscriptions.append(self)

    def take_message(self, kind: type[Any], raw: bool) -> tuple[Any, dict[str, Any]] | None:
        if not self.waiting:
            return None
        data, information = self.waiting.popleft()
        return (data if raw else real.rclpy_deserialize(data, kind)), information

    def get_publisher_count(self) -> int:
        return sum(fit(one, self) for one in domain().publishers)
