"""All that nodes of a loopback have made, and the nodes themselves: names, rules, parameters, identities."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rclpy.expand_topic_name import expand_topic_name
from rclpy.impl.implementation_singleton import rclpy_implementation as real

from facts_damping.nodes.loopback.arguments import Arguments, parse
from facts_damping.nodes.loopback.processes import process, world

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.nodes.loopback.services import Client, Service
    from facts_damping.nodes.loopback.topics import Publisher, Subscription

GID_TAIL = 4  # bytes of an identity that tell the ends of a participant apart
_handles = itertools.count(1)


@dataclass
class Domain:
    """All that nodes of a world have made."""

    nodes: list[Node] = field(default_factory=list)
    publishers: list[Publisher] = field(default_factory=list)
    subscriptions: list[Subscription] = field(default_factory=list)
    services: list[Service] = field(default_factory=list)
    clients: list[Client] = field(default_factory=list)


def domain() -> Domain:
    """That of the process whose turn it is."""
    found: Domain = world().main.values.setdefault("domain", Domain())
    return found


class Destroyable:
    """A handle: its number stands for its address."""

    def __init__(self) -> None:
        self.pointer = next(_handles)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def destroy_when_not_in_use(self) -> None:
        """Nobody finds it any more."""
        for ends in vars(domain()).values():
            if self in ends:
                ends.remove(self)


class Context(Destroyable):
    """What a process is to ROS: its arguments."""

    def __init__(self, arguments: Sequence[str], domain_id: int) -> None:
        super().__init__()
        self.arguments, self._domain_id, self._ok = parse(list(arguments)), domain_id, True

    def ok(self) -> bool:
        return self._ok

    def shutdown(self) -> None:
        self._ok = False

    def get_domain_id(self) -> int:
        return 0 if self._domain_id == real.RCL_DEFAULT_DOMAIN_ID else self._domain_id


class Node(Destroyable):
    """A node: its name, its rules, its identity."""

    def __init__(
        self, name: str, namespace: str, context: Context, cli: Any, use_global: bool, rosout: bool, _qos: Any
    ) -> None:
        super().__init__()
        given = [parse(cli or [])] + ([context.arguments] if use_global else [])
        self._name, self._namespace, self.context = name, f"/{namespace.strip('/')}", context
        self.rules = Arguments([r for one in given for r in one.remaps], [p for one in given for p in one.parameters])
        for node, left, right in self.rules.remaps:
            if node in (None, name):
                self._name = right if left in ("__node", "__name") else self._name
                self._namespace = f"/{right.strip('/')}" if left == "__ns" else self._namespace
        self.identity = self.pointer.to_bytes(12, "big")
        self.ends = itertools.count(1)
        domain().nodes.append(self)
        self.rosout = rosout
        process().at_end.append(self.leave)

    def leave(self) -> None:
        """Nobody finds it, or an end of it, any more, however its process has ended."""
        for ends in vars(domain()).values():
            ends[:] = [one for one in ends if one is not self and getattr(one, "node", None) is not self]

    def get_node_name(self) -> str:
        return self._name

    def get_namespace(self) -> str:
        return self._namespace

    def get_fully_qualified_name(self) -> str:
        return f"{self._namespace.rstrip('/')}/{self._name}"

    def logger_name(self) -> str:
        return self.get_fully_qualified_name().strip("/").replace("/", ".")

    def get_parameters(self, kind: type[Any]) -> dict[str, Any]:
        """Parameters that were given, by name; later ones count."""
        wanted = (None, self._name, self.get_fully_qualified_name().lstrip("/"))
        return {name: kind(name, value=value) for node, name, value in self.rules.parameters if node in wanted}

    def full(self, name: str) -> str:
        """A name of a topic or service in full, before remapping."""
        found: str = expand_topic_name(name, self._name, self._namespace)
        return found

    def remapped(self, full: str) -> str:
        """Where a full name leads."""
        for node, left, right in self.rules.remaps:
            if node in (None, self._name) and not left.startswith("__") and self.full(left) == full:
                return self.full(right)
        return full

    def resolve(self, name: str) -> str:
        """Where a name leads."""
        return self.remapped(self.full(name))

    def identity_of_an_end(self) -> bytes:
        """A new one, for a publisher or a subscription."""
        return self.identity + next(self.ends).to_bytes(GID_TAIL, "big")

    def get_count_publishers(self, topic: str) -> int:
        return sum(one.topic == topic for one in domain().publishers)

    def get_count_subscribers(self, topic: str) -> int:
        return sum(one.topic == topic for one in domain().subscriptions)

    def get_count_services(self, name: str) -> int:
        return sum(one.name == name for one in domain().services)

    def get_count_clients(self, name: str) -> int:
        return sum(one.service_name == name for one in domain().clients)

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(one.get_node_name(), one.get_namespace()) for one in domain().nodes]

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        return [(*one, "/") for one in self.get_node_names_and_namespaces()]
