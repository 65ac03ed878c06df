"""Who speaks on the topics of a graph: the one publisher that each has, the plant's, and who comes after it."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from facts_damping.nodes.admission.refusals import node_name
from facts_damping.nodes.base.discovery import NODE
from facts_damping.nodes.base.topics import TOPIC
from facts_damping.nodes.transport.cdr import Refused

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from facts_damping.nodes.base.parameters import Options

KNOW_S = 0.01  # wall time between two looks at who publishes, at least
SILENT_S = 1.0  # wall time without a message after which one of the same name may take the place of a node
PLANT = "plant/state"  # who publishes it is the plant


def now() -> float:
    """Wall time, s, since some moment."""
    return time.monotonic()


@dataclass
class TopicState:
    """A topic that is listened to, and what has come by it."""

    topic: str
    read: Callable[[bytes], tuple[Any, ...]] | None
    newest: Callable[[], int] | None
    use: Callable[..., None]
    begins: Callable[[bytes], bool] | None
    common: bool
    plant: bool = False  # the plant alone is heard, where all may speak
    leads: bool = False  # frames: who is new there with an earlier tick begins another run
    silent: bool = False  # not subscribed to: only its publisher is known
    publisher: bytes | None = None  # identity of who publishes it in this graph, once that is known
    sequences: dict[bytes, int] = field(default_factory=dict)  # of the newest message, by publisher
    lost: Counter[bytes] = field(default_factory=Counter)  # messages that did not come, by the gaps of those
    tick: int = -1  # of the newest message
    at: float = field(default_factory=now)  # when it came


class Publishers:
    """Who publishes what a node hears, as far as that is known; who may."""

    def __init__(self, node: Node, options: Options, graph: str) -> None:
        """`graph`: what leads from the node to the topics of its graph (node.py)."""
        self.topics: list[TopicState] = []
        self.names: dict[bytes, str] = {}  # of nodes whose messages were let in, by publisher
        self.plant: TopicState | None = None  # a topic that the plant publishes
        self._node, self._options, self._graph = node, options, graph
        self._looked_at = self._sought_at = 0.0
        self._heirs: dict[str, bytes] = {}  # by topic: who is alone where its publisher has left

    def know_plant(self, topic: str = PLANT) -> None:
        """Know the plant by a topic that it publishes, whether that is listened to or not."""
        name = self._node.resolve_topic_name(f"{self._graph}{topic}")
        self.plant = next((heard for heard in self.topics if heard.topic == name), None)
        if self.plant is None:
            self.plant = TopicState(name, None, None, _nothing, None, common=False, silent=True)
            self.topics.append(self.plant)

    def is_plant(self, publisher: bytes) -> bool:
        """Whether a publisher is of the plant's node."""
        if self.plant is not None and self.plant.publisher is None:
            self.know()
        known = self.plant.publisher if self.plant is not None else None
        return known is not None and publisher[:NODE] == known[:NODE]

    def name(self, topic: str, publisher: bytes) -> str:
        """The node of a publisher, kept once it is known; until then its identity."""
        if publisher not in self.names and (name := node_name(self._node, topic, publisher)):
            self.names[publisher] = name
        return self.names.get(publisher, publisher.hex())

    def know(self) -> None:
        """Look who publishes: the only one is this graph's, for good."""
        if time.monotonic() - self._looked_at < KNOW_S:
            return
        self._looked_at = time.monotonic()
        for heard in self.topics:
            if heard.publisher is None and heard.begins is None and not heard.common:
                there = self.of(heard.topic)
                if len(there) == 1:
                    heard.publisher = there[0]

    def another_plant(self, heard: TopicState, publisher: bytes) -> bool:
        """Whether somebody new speaks where the plant did; or for a link, and the plant is another one by now."""
        if not self._options.free or heard.common or heard.publisher in (None, publisher) or self.plant is None:
            return False
        before = self.plant.publisher
        if before is None or (heard.publisher or b"")[:NODE] == before[:NODE]:
            return before is not None
        there = self.of(self.plant.topic)
        return heard.leads and bool(there) and before not in there

    def admit(self, heard: TopicState, data: bytes, publisher: bytes) -> None:
        """Refuse a message of somebody else's."""
        if publisher == heard.publisher:
            return
        if not heard.common:
            self._recognise(heard, data, publisher)
        elif publisher[:NODE] not in self._nodes():
            self.know()
            if self._complete() and publisher[:NODE] not in self._nodes() | self._succeeding() | self._myself():
                raise Refused("publisher")

    def _recognise(self, heard: TopicState, data: bytes, publisher: bytes) -> None:
        """Whose a topic is, when a message comes before that is known: who begins, else who is alone or first."""
        if heard.publisher is None:
            self.know()
        if heard.publisher is None and (heard.begins is None or heard.begins(data)):
            heard.publisher = publisher
        if publisher != heard.publisher and publisher[:NODE] not in self._succeeding(heard):
            raise Refused("publisher")

    def _succeeding(self, heard: TopicState | None = None) -> set[bytes]:
        """Nodes that, unless in lockstep, take the place of a topic's publisher (of any topic, if none is given).

        It has left, and they are alone; or it is silent, and they have its name: DDS takes 20 s to see that a node was
        killed. In real time as long as the plant is there: without it the run is over, and it has no successor.
        """
        if self._options.paced and time.monotonic() - self._sought_at > KNOW_S:
            self._sought_at = time.monotonic()
            known = {one.topic: one for one in self.topics if one.publisher is not None}
            plant = known.get(self.plant.topic) if self.plant is not None else None
            over = plant is not None and plant.publisher not in self.of(plant.topic)
            heirs = {
                topic: self._heir(one)
                for topic, one in known.items()
                if self._options.free or not (over or self.is_plant(one.publisher or b""))
            }
            self._heirs = {topic: heir for topic, heir in heirs.items() if heir is not None}
        return {gid[:NODE] for topic, gid in self._heirs.items() if heard is None or topic == heard.topic}

    def _heir(self, heard: TopicState) -> bytes | None:
        """Who alone takes the place of a topic's publisher; None: nobody."""
        there = self.of(heard.topic)
        others = [publisher for publisher in there if publisher != heard.publisher]
        if len(others) != 1:
            return None
        if heard.publisher in there:
            if heard.silent or now() - heard.at < SILENT_S:
                return None
            ends = self._node.get_publishers_info_by_topic(heard.topic)
            if len({(one.node_namespace, one.node_name) for one in ends}) > 1:
                return None
        return others[0]

    def of(self, topic: str) -> list[bytes]:
        """Identities of all that publish on a topic now."""
        return [bytes(one.endpoint_gid) for one in self._node.get_publishers_info_by_topic(topic)]

    def _complete(self) -> bool:
        """Whether all nodes are known: until then one that speaks on a common topic first may be this graph's."""
        return all(heard.publisher is not None for heard in self.topics if not heard.common and not heard.silent)

    def _nodes(self) -> set[bytes]:
        return {heard.publisher[:NODE] for heard in self.topics if heard.publisher is not None}

    def _myself(self) -> set[bytes]:
        """This node, as others know it: where it hears on a topic on which it speaks."""
        name, place = self._node.get_name(), self._node.get_namespace()
        there = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(f"{self._graph}{TOPIC}"))
        return {bytes(one.endpoint_gid)[:NODE] for one in there if (one.node_name, one.node_namespace) == (name, place)}


def _nothing() -> None:
    """For a topic that nothing is heard of."""
