"""Replacements of rclpy's C++ part, by their names in `rclpy._rclpy_pybind11`; all other names are rclpy's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import Log
from rclpy.impl.implementation_singleton import rclpy_implementation as real
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.qos import qos_profile_rosout_default
from rclpy.type_support import check_for_type_support

from facts_damping_testing.loopback import domain as domains
from facts_damping_testing.loopback.domain import Context, Destroyable, domain, known
from facts_damping_testing.loopback.lifecycle import LifecycleStateMachine
from facts_damping_testing.loopback.processes import wall_ns, world
from facts_damping_testing.loopback.services import (
    Client,
    Service,
    TypeDescriptionService,
    rmw_request_id_t,
    rmw_service_info_t,
)
from facts_damping_testing.loopback.topics import Publisher, Subscription
from facts_damping_testing.loopback.waiting import Clock, GuardCondition, Timer, WaitSet

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_testing.loopback.domain import Endpoint
    from facts_damping_testing.loopback.topics import TopicEndpoint


class Node(domains.Node):
    """A node that counts the endpoints that it knows."""

    def get_count_publishers(self, topic: str) -> int:
        return len(known(self, domain().of(Publisher), topic))

    def get_count_subscribers(self, topic: str) -> int:
        return len(known(self, domain().of(Subscription), topic))

    def get_count_services(self, name: str) -> int:
        return len(known(self, domain().of(Service), name))

    def get_count_clients(self, name: str) -> int:
        return len(known(self, domain().of(Client), name))


class EventHandle:
    """Endpoints of a loopback have no events."""

    def __init__(self, *_: Any) -> None:
        raise real.UnsupportedEventTypeError("loopback: no events")


class Logger(RcutilsLogger):
    """Publishes logs on /rosout only."""

    def log(self, message: str, severity: Any, *_: Any, **__: Any) -> bool:
        world().logs.append((world().now_ns, str(self.name), int(severity), str(message)))
        node = next(
            (candidate for candidate in domain().of(domains.Node) if candidate.logger_name() == self.name), None
        )
        if node is not None and node.rosout:
            text = Log(level=int(severity), name=self.name or "", msg=str(message))
            text.stamp.sec, text.stamp.nanosec = divmod(wall_ns(), 10**9)
            _rosout(node).publish(text)
        return True


def _rosout(node: domains.Node) -> Publisher:
    publishers: dict[Any, Publisher] = world().main.values.setdefault("rosout", {})
    if node not in publishers:
        check_for_type_support(Log)
        publishers[node] = Publisher(node, Log, "/rosout", qos_profile_rosout_default.get_c_qos_profile())
    return publishers[node]


def _info_by_topic(
    node: Node, endpoints: Sequence[TopicEndpoint], topic: str, endpoint_type: int
) -> list[dict[str, Any]]:
    return [endpoint.described(endpoint_type) for endpoint in known(node, endpoints, topic)]


def _types(endpoints: Sequence[Endpoint], kind: Callable[[Any], str]) -> list[tuple[str, list[str]]]:
    """Names of endpoints in order, each with its types."""
    kinds_of: dict[str, set[str]] = {}
    for endpoint in endpoints:
        kinds_of.setdefault(endpoint.name, set()).add(kind(endpoint))
    return sorted((name, sorted(kinds)) for name, kinds in kinds_of.items())


CLASSES = (
    *(Client, Clock, Context, Destroyable, EventHandle, GuardCondition, LifecycleStateMachine, Node, Publisher),
    *(Service, Subscription, Timer, TypeDescriptionService, WaitSet, rmw_request_id_t, rmw_service_info_t),
)
NAMES: dict[str, Any] = {cls.__name__: cls for cls in CLASSES} | {
    "rclpy_resolve_name": lambda node, name, only_expand, _: node.full(name) if only_expand else node.resolve(name),
    "rclpy_remap_topic_name": Node.remapped,
    "rclpy_get_publishers_info_by_topic": lambda node, topic, _: _info_by_topic(node, domain().of(Publisher), topic, 1),
    "rclpy_get_subscriptions_info_by_topic": lambda node, topic, _: _info_by_topic(
        node, domain().of(Subscription), topic, 2
    ),
    "rclpy_get_topic_names_and_types": lambda *_: _types(
        [*domain().of(Publisher), *domain().of(Subscription)], lambda endpoint: str(endpoint.described(0)["topic_type"])
    ),
    "rclpy_get_service_names_and_types": lambda *_: _types(
        domain().of(Service), lambda endpoint: str(endpoint.kind.__name__)
    ),
    "rclpy_get_rmw_implementation_identifier": lambda: "loopback",
    **dict.fromkeys(("register_sigint_guard_condition", "unregister_sigint_guard_condition"), lambda _: None),
    **dict.fromkeys(("rclpy_logging_configure", "rclpy_logging_fini"), lambda *_: None),
}
