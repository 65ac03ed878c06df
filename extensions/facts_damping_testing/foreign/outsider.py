"""A foreign node: it follows the run, publishes whatever it is given, and calls services."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import rclpy
from facts_damping_msgs.msg import PmuDataFrame
from facts_damping_msgs.srv import Apply, Step
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import SetParameters
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from facts_damping.nodes import clock
from facts_damping.nodes.base.qos import LOGGED, PUBLISHER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.topics import FRAMES
from facts_damping.nodes.recorder import LATE, TICK_END, topics

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.case.model import Case

SERVICES: dict[str, tuple[Any, Callable[[Any], dict[str, Any]]]] = {
    "step": (Step, lambda value: {"ticks": int(value)}),
    "apply": (Apply, lambda value: {"change": str(value)}),
    "change_state": (ChangeState, lambda value: {"transition": _transition(value)}),
}  # kind and fields of requests by the service's name; others are triggers


def _transition(number: Any) -> Any:
    transition = ChangeState.Request().transition
    transition.id = int(number)
    return transition


class Outsider:
    """A node that is not part of the graph."""

    def __init__(self, case: Case) -> None:
        """Make its node, in the process that runs."""
        rclpy.init()
        self.node = rclpy.create_node("outsider", start_parameter_services=False, enable_rosout=False)
        self.kinds = topics(case)
        self.newest, self.kept = -1, dict[str, list[bytes]]()  # newest tick; messages received, by topic
        self._read: list[Any] = []  # subscriptions
        self._publishers: dict[str, Any] = {}
        self.sent: dict[str, int] = {}  # number of messages published to the recorder, by topic
        self.listen(FRAMES, PmuDataFrame, self._on_frames)

    def listen(self, topic: str, kind: Any, use: Callable[[bytes], Any]) -> None:
        """Subscribe to a topic."""
        self._read.append(self.node.create_subscription(kind, topic, use, SUBSCRIBER_QOS, raw=True))

    def ignore(self, topic: str) -> None:
        """Subscribe to a topic and never read it."""
        self.node.create_subscription(self.kinds[topic], topic, lambda _: None, SUBSCRIBER_QOS, raw=True)

    def keep(self, topic: str) -> None:
        """Keep the messages of a topic from now on."""
        if topic not in self.kept:
            messages = self.kept.setdefault(topic, [])
            self.listen(topic, self.kinds[topic], messages.append)

    def _on_frames(self, data: bytes) -> None:
        self.newest = max(self.newest, min(int.from_bytes(data[TICK_END : TICK_END + 8], "little"), self.newest + 1000))

    def take(self) -> None:
        """Take the messages that have come from others."""
        handle: Any = self.node.handle
        identity = handle.identity
        for subscription in self._read:
            while (message := subscription.handle.take_message(subscription.msg_type, True)) is not None:
                if not message[1]["publisher_gid"]["data"].startswith(identity):
                    subscription.callback(message[0])

    def wait(self, until_s: float) -> None:
        """Wait for messages until a time, and take them."""
        make: Any = rclpy_implementation.WaitSet
        wait_set = make(len(self._read), 0, 0, 0, 0, 0, None)
        for subscription in self._read:
            wait_set.add_subscription(subscription.handle)
        wait_set.wait(max(0, int(1e9 * (until_s - clock.monotonic()))))
        self.take()

    def publish(self, topic: str, data: bytes) -> None:
        """Publish bytes on a topic of the graph."""
        if topic not in self._publishers:
            qos = LOGGED if topic in LATE else PUBLISHER_QOS
            self._publishers[topic] = self.node.create_publisher(self.kinds[topic], topic, qos)
        publisher: Any = self._publishers[topic]
        readers = [reader.node.get_node_name() for reader in publisher.handle.readers()]
        publisher.publish(data)
        self.sent[topic] = self.sent.get(topic, 0) + readers.count("recorder")

    def call(self, node: str, service: str, value: Any) -> None:
        """Send a request; the answer is not awaited."""
        kind, fields = SERVICES.get(service, (Trigger, lambda _: {}))
        client: Any = self.node.create_client(kind, f"{node}/{service}")
        if client.service_is_ready():
            client.call_async(kind.Request(**fields(value)))

    def set_parameter(self, node: str, name: str, value: Any) -> None:
        """Send a new value of a parameter; the answer is not awaited."""
        client: Any = self.node.create_client(SetParameters, f"{node}/set_parameters")
        message: Any = Parameter(name, value=value).to_parameter_msg()
        if client.service_is_ready():
            client.call_async(SetParameters.Request(parameters=[message]))
