"""What rclpy has in C++, by its names there (`rclpy._rclpy_pybind11`); what is not here is rclpy's own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import Log
from rclpy.impl.implementation_singleton import rclpy_implementation as real
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.qos import qos_profile_rosout_default
from rclpy.type_support import check_for_type_support

from facts_damping.nodes.loopback.domain import Context, Destroyable, Node, domain
from facts_damping.nodes.loopback.lifecycle import LifecycleStateMachine
from facts_damping.nodes.loopback.processes import wall_ns, world
from facts_damping.nodes.loopback.services import (
    Client,
    Service,
    TypeDescriptionService,
    rmw_request_id_t,
    rmw_service_info_t,
)
from facts_damping.nodes.loopback.topics import Publisher, Subscription
from facts_damping.nodes.loopback.waiting import Clock, GuardCondition, Timer, WaitSet

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class EventHandle:
    """Ends here tell of nothing."""

    def __init__(self, *_: Any) -> None:
        raise real.UnsupportedEventTypeError("loopback: no events")


class Logger(RcutilsLogger):
    """Logs go to /rosout alone."""

    def log(self, message: str, severity: Any, *_: Any, **__: Any) -> bool:
        """Publish it, as the node of this name."""
        node = next((one for one in domain().nodes if one.logger_name() == self.name), None)
        if node is not None and node.rosout:
            now = wall_ns()
            text = Log(level=int(severity), name=self.name or "", msg=str(message))
            text.stamp.sec, text.stamp.nanosec = divmod(now, 10**9)
            rosout(node).publish(text)
        return True


def rosout(node: Node) -> Publisher:
    """The publisher of a node's logs."""
    kept: dict[Any, Publisher] = world().main.values.setdefault("rosout", {})
    if node not in kept:
        check_for_type_support(Log)
        kept[node] = Publisher(node, Log, "/rosout", qos_profile_rosout_default.get_c_qos_profile())
    return kept[node]


def rclpy_resolve_name(node: Node, name: str, only_expand: bool, _is_service: bool) -> str:
    """A name in full."""
    return node.full(name) if only_expand else node.resolve(name)


def rclpy_remap_topic_name(node: Node, name: str) -> str:
    """Where a full name leads."""
    return node.remapped(name)


def rclpy_get_publishers_info_by_topic(_node: Node, topic: str, _no_mangle: bool) -> list[dict[str, Any]]:
    """Of all publishers of a topic."""
    return [one.described(1) for one in domain().publishers if one.topic == topic]


def rclpy_get_subscriptions_info_by_topic(_node: Node, topic: str, _no_mangle: bool) -> list[dict[str, Any]]:
    """Of all readers of a topic."""
    return [one.described(2) for one in domain().subscriptions if one.topic == topic]


def _types(ends: Sequence[Any], name: Callable[[Any], str], kind: Callable[[Any], str]) -> list[tuple[str, list[str]]]:
    found: dict[str, set[str]] = {}
    for one in ends:
        found.setdefault(name(one), set()).add(kind(one))
    return sorted((topic, sorted(kinds)) for topic, kinds in found.items())


def rclpy_get_topic_names_and_types(_node: Node, _no_demangle: bool) -> list[tuple[str, list[str]]]:
    """All topics, with their types."""
    ends = [*domain().publishers, *domain().subscriptions]
    return _types(ends, lambda one: one.topic, lambda one: str(one.described(0)["topic_type"]))


def rclpy_get_service_names_and_types(_node: Node) -> list[tuple[str, list[str]]]:
    """All services, with their types."""
    return _types(domain().services, lambda one: one.name, lambda one: str(one.kind.__name__))


def register_sigint_guard_condition(_condition: GuardCondition) -> None:
    """Signals wake nobody."""


def unregister_sigint_guard_condition(_condition: GuardCondition) -> None:
    """As above."""


def rclpy_logging_configure(_context: Context) -> None:
    """Logs go to /rosout alone."""


def rclpy_logging_fini() -> None:
    """As above."""


def rclpy_get_rmw_implementation_identifier() -> str:
    """What carries messages."""
    return "loopback"


NAMES = {
    one.__name__: one
    for one in (
        *(Client, Clock, Context, Destroyable, EventHandle, GuardCondition, LifecycleStateMachine, Node, Publisher),
        *(Service, Subscription),
        *(Timer, TypeDescriptionService, WaitSet, rmw_request_id_t, rmw_service_info_t),
        *(rclpy_resolve_name, rclpy_remap_topic_name, rclpy_get_topic_names_and_types),
        *(rclpy_get_service_names_and_types, rclpy_get_publishers_info_by_topic),
        *(rclpy_get_subscriptions_info_by_topic, rclpy_get_rmw_implementation_identifier),
        *(register_sigint_guard_condition, unregister_sigint_guard_condition),
        *(rclpy_logging_configure, rclpy_logging_fini),
    )
}
