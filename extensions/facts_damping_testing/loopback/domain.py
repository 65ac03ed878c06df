"""The nodes of a loopback with their names, arguments, parameters and identities, and the endpoints of all nodes."""

from __future__ import annotations

import itertools
from collections import defaultdict, deque
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from rclpy.expand_topic_name import expand_topic_name
from rclpy.impl.implementation_singleton import rclpy_implementation as real

from facts_damping_testing.loopback.processes import process, world

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

D = TypeVar("D", bound="Destroyable")
E = TypeVar("E", bound="Endpoint")
GID_TAIL = 4  # bytes of an identity that distinguish the endpoints of a participant
_handles = itertools.count(1)
PARAMETER, REMAPPING, FILE = ("-p", "--param"), ("-r", "--remap"), ("--params-file",)


@dataclass
class Arguments:
    """Rules in the order given; each has the name of the node that it is for, or None for all nodes."""

    remaps: list[tuple[str | None, str, str]] = field(default_factory=list)
    parameters: list[tuple[str | None, str, Any]] = field(default_factory=list)


def parse(command_line: Sequence[str]) -> Arguments:
    """Read the arguments between `--ros-args` and `--`; others are the program's own."""
    arguments, for_ros, words = Arguments(), False, iter(command_line)
    for word in words:
        if word in ("--ros-args", "--"):
            for_ros = word == "--ros-args"
        elif for_ros and word in (*PARAMETER, *REMAPPING):
            rule = next(words, "")
            left, assigns, right = rule.partition(":=")
            if not assigns:
                raise RuntimeError(f"Couldn't parse argument: '{word} {rule}'")
            before, colon, after = left.partition(":")
            node, name = (before, after) if colon else (None, left)
            if word in PARAMETER:
                arguments.parameters.append((node, name, yaml.safe_load(right)))
            else:
                arguments.remaps.append((node, name, right))
        elif for_ros and word in FILE:
            arguments.parameters += _from_file(Path(next(words, "")))
    return arguments


def _from_file(path: Path) -> Iterator[tuple[str | None, str, Any]]:
    for node, content in (yaml.safe_load(path.read_text(encoding="utf-8")) or {}).items():
        for name, value in _flat(content.get("ros__parameters", {})):
            yield None if set(node) <= set("/*") else node.lstrip("/"), name, value


def _flat(content: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


@dataclass
class Domain:
    """Nodes and endpoints of a world, by class and in the order in which they came."""

    version: int = 0  # changes with the endpoints
    by_class: dict[type[Any], list[Any]] = field(default_factory=lambda: defaultdict(list))

    def of(self, kind: type[D]) -> list[D]:
        """Nodes, or endpoints of a class."""
        return self.by_class[kind]

    def add(self, kind: type[D], added: D) -> None:
        """Add a node, or an endpoint of a class."""
        self.by_class[kind].append(added)
        self.version += 1

    def remove(self, gone: Callable[[Any], bool]) -> None:
        """Remove nodes and endpoints."""
        for ends in self.by_class.values():
            ends[:] = [end for end in ends if not gone(end)]
        self.version += 1


def domain() -> Domain:
    """The domain of the running process."""
    values = world().main.values
    if "domain" not in values:
        values["domain"] = Domain()
    process_domain: Domain = values["domain"]
    return process_domain


def known(observer: Node, ends: Iterable[E], name: str) -> list[E]:
    """Those endpoints of a name that a node knows."""
    here = world()
    return [end for end in ends if end.name == name and here.middleware.knows(here.now_ns, observer, end)]


class Destroyable:
    """A handle; `pointer` is a number in place of an address."""

    def __init__(self) -> None:
        self.pointer = next(_handles)

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def destroy_when_not_in_use(self) -> None:
        domain().remove(lambda entity: entity is self)


class Context(Destroyable):
    """The context of a process: its arguments."""

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
    """A node: name, arguments, identity."""

    def __init__(
        self, name: str, namespace: str, context: Context, cli: Any, use_global: bool, rosout: bool, _qos: Any
    ) -> None:
        super().__init__()
        arguments = [parse(cli or [])] + ([context.arguments] if use_global else [])
        self._name, self._namespace, self.context = name, f"/{namespace.strip('/')}", context
        self.rules = Arguments(
            [rule for parsed in arguments for rule in parsed.remaps],
            [rule for parsed in arguments for rule in parsed.parameters],
        )
        for node, left, right in self.rules.remaps:
            if node in (None, name):
                self._name = right if left in ("__node", "__name") else self._name
                self._namespace = f"/{right.strip('/')}" if left == "__ns" else self._namespace
        self.identity = self.pointer.to_bytes(12, "big")
        self.ends = itertools.count(1)
        self.process, self.since_ns = process(), world().now_ns
        domain().add(Node, self)
        self.rosout = rosout
        self.process.at_end.append(self.leave)

    def leave(self) -> None:
        """Leave the domain when the process ends; others notice that it was killed after the middleware's lease."""
        here, lease_ns = world(), world().middleware.lease_ns if self.process.killed else 0
        if lease_ns:
            here.at(here.now_ns + lease_ns, self._vanish)
        else:
            self._vanish()

    def _vanish(self) -> None:
        domain().remove(lambda entity: entity is self or getattr(entity, "node", None) is self)

    def get_node_name(self) -> str:
        return self._name

    def get_namespace(self) -> str:
        return self._namespace

    def get_fully_qualified_name(self) -> str:
        return f"{self._namespace.rstrip('/')}/{self._name}"

    def logger_name(self) -> str:
        return self.get_fully_qualified_name().strip("/").replace("/", ".")

    def get_parameters(self, kind: type[Any]) -> dict[str, Any]:
        """Parameters from the arguments, by name; later ones replace earlier ones."""
        wanted = (None, self._name, self.get_fully_qualified_name().lstrip("/"))
        return {name: kind(name, value=value) for node, name, value in self.rules.parameters if node in wanted}

    def full(self, name: str) -> str:
        """Full name of a topic or service, before remapping."""
        expanded: str = expand_topic_name(name, self._name, self._namespace)
        return expanded

    def remapped(self, full: str) -> str:
        """A full name after remapping."""
        for node, left, right in self.rules.remaps:
            if node in (None, self._name) and not left.startswith("__") and self.full(left) == full:
                return self.full(right)
        return full

    def resolve(self, name: str) -> str:
        return self.remapped(self.full(name))

    def get_node_names_and_namespaces(self) -> list[tuple[str, str]]:
        return [(node.get_node_name(), node.get_namespace()) for node in domain().of(Node)]  # all, at once

    def get_node_names_and_namespaces_with_enclaves(self) -> list[tuple[str, str, str]]:
        return [(*name_and_namespace, "/") for name_and_namespace in self.get_node_names_and_namespaces()]


class Endpoint(Destroyable):
    """A publisher, subscription, service or client, with its queue of messages."""

    def __init__(self, node: Node, kind: Any, name: str, qos: Any) -> None:
        super().__init__()
        self.node, self.kind, self.name, self.qos = node, kind, node.resolve(name), qos
        self.waiting: deque[Any] = deque()
        self.since_ns = world().now_ns
        self.known_ns: dict[Node, int] = {}  # when nodes discover it
        self.under_way = 0  # messages that have not arrived yet

    def get_logger_name(self) -> str:
        return self.node.logger_name()

    def is_ready(self) -> bool:
        return bool(self.waiting)


def deliver(sender: Endpoint, receiver: Endpoint, message: Any) -> None:
    """Let a message arrive when the middleware says so; a process that was killed sends and receives none."""
    here = world()
    at = here.middleware.arrival_ns(here.now_ns, sender, receiver)
    if at is None or receiver.node.process.exitcode is not None or receiver.node.process.killed:
        return
    if sender.node.process.killed:  # what it does on its way out
        return
    if at <= here.now_ns:
        _arrive(receiver, message)
    else:
        receiver.under_way += 1
        here.at(at, partial(_arrive_late, receiver, message))


def _arrive_late(receiver: Endpoint, message: Any) -> None:
    receiver.under_way -= 1
    _arrive(receiver, message)


def _arrive(receiver: Endpoint, message: Any) -> None:
    receiver.waiting.append(message)
    here = world()
    if len(receiver.waiting) > here.longest_queue and receiver.node.process.responds:
        here.longest_queue = len(receiver.waiting)
