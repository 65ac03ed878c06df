"""Topics of a loopback: messages go from publishers to subscriptions as bytes, when its middleware says so.

As with DDS, qualities of service must fit, each subscription has a queue, and a late one receives what the publisher of
a transient local topic keeps.
"""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any

from rclpy.impl.implementation_singleton import rclpy_implementation as real

from facts_damping_testing.loopback.domain import GID_TAIL, Endpoint, deliver, domain
from facts_damping_testing.loopback.processes import wall_ns, world

if TYPE_CHECKING:
    from facts_damping_testing.loopback.domain import Node

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
    if not world().middleware.match(subscription):
        return False
    reliable = int(publisher.qos["reliability"]) == RELIABLE or int(subscription.qos["reliability"]) != RELIABLE
    return reliable and (publisher.latched or not subscription.latched)


def _send_kept(publisher: Publisher, subscription: Subscription) -> None:
    """Send a late subscription what its latched publisher keeps, once both know each other."""
    here = world()
    known_from_ns = here.middleware.known_from_ns
    at = max(known_from_ns(publisher.node, subscription), known_from_ns(subscription.node, publisher))
    if at > here.now_ns:
        here.at(at, partial(_send_kept, publisher, subscription))
        return
    for message in publisher.waiting:
        deliver(publisher, subscription, message)


class Publisher(TopicEndpoint):
    """Sends messages to all subscriptions of its topic; its queue has those that it keeps for late ones."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._count, self._version, self._fitting = 0, -1, list[Subscription]()
        domain().add(Publisher, self)

    def readers(self) -> list[Subscription]:
        """The subscriptions that it sends to: those that it knows. One that does not know it yet gets them then."""
        ends = domain()
        if self._version != ends.version:
            self._version, self._fitting = (
                ends.version,
                [subscription for subscription in ends.of(Subscription) if fit(self, subscription)],
            )
        here = world()
        knows, now = here.middleware.knows, here.now_ns
        return [subscription for subscription in self._fitting if knows(now, self.node, subscription)]

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
        message = bytes(data), information
        if self.latched:
            self.waiting.append(message)
        for subscription in self.readers():
            deliver(self, subscription, message)

    def get_subscription_count(self) -> int:
        return len(self.readers())

    def wait_for_all_acked(self, timeout: Any) -> bool:
        """Wait until all that was sent has arrived at readers that respond; a killed one is waited for in vain."""

        def acked() -> bool:
            return all(
                subscription.node.process.responds and not subscription.under_way for subscription in self.readers()
            )

        if not acked():
            world().wait(acked, world().now_ns + timeout.nanoseconds)
        return acked()


class Subscription(TopicEndpoint):
    """A queue of messages."""

    def __init__(self, node: Node, kind: type[Any], topic: str, qos: Any, _filter: Any = None) -> None:
        super().__init__(node, kind, topic, qos)
        here = domain()
        here.add(Subscription, self)
        for publisher in here.of(Publisher) if self.latched else ():
            if fit(publisher, self):
                _send_kept(publisher, self)

    def take_message(self, kind: type[Any], raw: bool) -> tuple[Any, dict[str, Any]] | None:
        if not self.waiting:
            return None
        data, information = self.waiting.popleft()
        return (data if raw else real.rclpy_deserialize(data, kind)), information

    def get_publisher_count(self) -> int:
        return sum(self in publisher.readers() for publisher in domain().of(Publisher))
