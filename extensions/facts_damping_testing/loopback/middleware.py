"""The middleware of a loopback, and what may be wrong with it: discovery, late, lost and held messages.

Without faults, endpoints know each other at once and messages arrive at once, as on an idle machine.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import Any, Protocol

from facts_damping.signals import NEVER


class Process(Protocol):
    """What the middleware knows of a process (`processes.Process`)."""

    stopped_ns: int  # when it was suspended or killed; NEVER: it may run


class Node(Protocol):
    """What the middleware knows of a node (`domain.Node`)."""

    since_ns: int

    @property
    def process(self) -> Process:
        """The process that it runs in."""

    def get_node_name(self) -> str:
        """Its name without the namespace."""


class Endpoint(Protocol):
    """What the middleware knows of a publisher, subscription, service or client (`domain.Endpoint`)."""

    name: str
    since_ns: int
    known_ns: dict[Any, int]  # by node: when it discovers the endpoint

    @property
    def node(self) -> Node:
        """The node that it belongs to."""


@dataclass
class Disturbance:
    """What happens to messages between two times, of one node (to and from it) or all, and of one topic or all.

    The messages of one publisher to one subscription stay in order, as with reliable DDS; those of several do not.
    """

    begins_ns: int
    ends_ns: int
    node: str = ""  # name; empty: all
    topic: str = ""  # end of its name; empty: all
    late_ns: int = 0  # longest delay
    loss: float = 0.0  # fraction lost, as from a full queue
    cut: bool = False  # messages wait until it ends, and after the lease the node is taken to have left
    seed: int = 0

    def __post_init__(self) -> None:
        """Begin its random numbers."""
        self._random = random.Random(self.seed)

    def concerns(self, now_ns: int, node: Node) -> bool:
        """Whether it acts now on a node."""
        return self.begins_ns <= now_ns < self.ends_ns and self.node in ("", node.get_node_name())

    def arrival_ns(self, now_ns: int, sender: Endpoint, receiver: Endpoint) -> int | None:
        """When a message sent now arrives; None: never."""
        if not receiver.name.endswith(self.topic) or not any(self.concerns(now_ns, e.node) for e in (sender, receiver)):
            return now_ns
        if self.cut:
            return self.ends_ns if self.ends_ns != NEVER else None
        if self.loss and self._random.random() < self.loss:
            return None
        return now_ns + int(self.late_ns * self._random.random())


@dataclass
class Middleware:
    """Discovery and delivery of a world."""

    seed: int = 0
    discovery_ns: int = 0  # longest time until a node knows an endpoint of another one
    lease_ns: int = 0  # time after which a node that was killed, suspended or cut off is forgotten
    unmatched: tuple[str, str] = ("", "")  # node whose subscription to a topic (its end) never matches
    disturbances: list[Disturbance] = field(default_factory=list)
    lost: set[str] = field(default_factory=set)  # nodes that messages to were lost
    _newest: dict[tuple[Endpoint, Endpoint], int] = field(default_factory=dict)  # arrival, by sender and receiver

    def known_from_ns(self, observer: Node, end: Endpoint) -> int:
        """Time from which a node knows an endpoint."""
        if not self.discovery_ns or observer is end.node:
            return 0
        if (at := end.known_ns.get(observer)) is not None:
            return at
        chance = random.Random(f"{self.seed} {observer.get_node_name()} {end.name} {type(end).__name__}")
        at = max(observer.since_ns, end.since_ns) + int(self.discovery_ns * chance.random())
        end.known_ns[observer] = at
        return at

    def knows(self, now_ns: int, observer: Node, end: Endpoint) -> bool:
        """Whether a node knows an endpoint now: it has discovered it and has not taken it to have left."""
        if observer is end.node:
            return True
        if self.discovery_ns and now_ns < self.known_from_ns(observer, end):
            return False
        if not self.lease_ns or (not self.disturbances and end.node.process.stopped_ns == NEVER):
            return True
        return now_ns - self._silent_since_ns(now_ns, observer, end) <= self.lease_ns

    def _silent_since_ns(self, now_ns: int, observer: Node, end: Endpoint) -> int:
        begins = [disturbance.begins_ns for disturbance in self.disturbances for node in (observer, end.node)
                  if disturbance.cut and not disturbance.topic and disturbance.concerns(now_ns, node)]  # fmt: skip
        return min([end.node.process.stopped_ns, *begins])

    def match(self, subscription: Endpoint) -> bool:
        """Whether a publisher and a subscription may ever match, as far as it is not their topic or quality."""
        node, topic = self.unmatched
        return not topic or subscription.node.get_node_name() != node or not subscription.name.endswith(topic)

    def arrival_ns(self, now_ns: int, sender: Endpoint, receiver: Endpoint) -> int | None:
        """When a message sent now arrives, not before earlier ones of the same two; None: it is lost.

        A reliable publisher keeps it for a receiver that does not know it yet.
        """
        at = max(now_ns, self.known_from_ns(receiver.node, sender)) if self.discovery_ns else now_ns
        for disturbance in self.disturbances:
            arrival = disturbance.arrival_ns(now_ns, sender, receiver)
            if arrival is None:
                if disturbance.loss:
                    self.lost.add(receiver.node.get_node_name())
                return None
            at = max(at, arrival)
        if self.disturbances or self.discovery_ns:
            at = self._newest[sender, receiver] = max(at, self._newest.get((sender, receiver), 0))
        return at
