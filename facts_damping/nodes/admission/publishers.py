"""Publishers of a graph's topics: the one publisher of each topic, the plant, and successors."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.nodes import clock
from facts_damping.nodes.admission.refusals import node_name
from facts_damping.nodes.base.discovery import NODE
from facts_damping.nodes.base.topics import PLANT_STATE, REFUSALS
from facts_damping.nodes.transport.cdr import Refused

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node

    from facts_damping.nodes.base.parameters import Options

KNOW_S = 0.01  # minimum wall time between two queries of the publishers
SILENT_S = 1.0  # wall time without a message after which a node of the same name may replace a node


class Reading(NamedTuple):
    """How messages of a topic are read.

    `read` decodes a message into its tick (absent on common topics) and further values, or raises `Refused`; None: its
    bytes are used. `newest`: returns the newest tick allowed. `begins`: tells whether a message is the first of a run;
    its publisher is then this graph's. `check`: returns the tick first, or raises `Refused` for a message that is not
    signed by this graph, where `read` does not.
    """

    read: Callable[[bytes], tuple[Any, ...]] | None = None
    newest: Callable[[], int] | None = None
    begins: Callable[[bytes], bool] | None = None
    check: Callable[[bytes], Any] | None = None


BYTES = Reading()


@dataclass
class TopicState:
    """A subscribed topic and what has come on it; the arguments are those of MessageFilter.subscribe."""

    topic: str
    reading: Reading
    use: Callable[..., None]
    common: bool
    plant: bool = False  # only the plant's messages are admitted, though all nodes may publish
    leads: bool = False  # frames: a new publisher with an earlier tick begins another run
    silent: bool = False  # not subscribed to: only its publisher is known
    publisher: bytes | None = None  # identity (GID) of its publisher in this graph, once known
    sequences: dict[bytes, int] = field(default_factory=dict)  # sequence number of the newest message, by publisher
    lost: Counter[bytes] = field(default_factory=Counter)  # missing sequence numbers, by publisher
    begun: bool = False  # whether a message was admitted
    tick: int = -1  # tick of the newest message
    checked: int = -1  # the same, where `read` does not tell it and `check` does
    # Wall time of its arrival; looked up late, as a loopback replaces the clock.
    at: float = field(default_factory=lambda: clock.monotonic())  # noqa: PLW0108


class Publishers:
    """Known and permitted publishers of the topics that a node subscribes to."""

    def __init__(self, node: Node, options: Options, graph: str) -> None:
        """`graph`: prefix of the graph's topics (base/topics.py)."""
        self.topics: list[TopicState] = []
        self.names: dict[bytes, str] = {}  # node names by publisher, of nodes whose messages were admitted
        self.plant: TopicState | None = None  # a topic that the plant publishes
        self._node, self._options, self._graph = node, options, graph
        self._checked_at = self._sought_at = 0.0
        self._heirs: dict[str, bytes] = {}  # successor of the publisher, by topic

    def know_plant(self, topic: str = PLANT_STATE) -> None:
        """Identify the plant by a topic that it publishes, whether the node subscribes to it or not."""
        name = self._node.resolve_topic_name(f"{self._graph}{topic}")
        self.plant = next((state for state in self.topics if state.topic == name), None)
        if self.plant is None:
            self.plant = TopicState(name, BYTES, lambda: None, common=False, silent=True)
            self.topics.append(self.plant)

    def is_plant(self, publisher: bytes) -> bool:
        """Whether a publisher belongs to the plant's node."""
        if self.plant is not None and self.plant.publisher is None:
            self.know()
        known = self.plant.publisher if self.plant is not None else None
        return known is not None and publisher[:NODE] == known[:NODE]

    def name(self, topic: str, publisher: bytes) -> str:
        """Node name of a publisher, cached once known; until then its identity in hexadecimal."""
        if publisher not in self.names and (name := node_name(self._node, topic, publisher)):
            self.names[publisher] = name
        return self.names.get(publisher, publisher.hex())

    def know(self) -> None:
        """Query the publishers: a topic's only publisher becomes this graph's, and stays so."""
        if clock.monotonic() - self._checked_at < KNOW_S:
            return
        self._checked_at = clock.monotonic()
        for state in self.topics:
            if state.publisher is None and state.reading.begins is None and not state.common:
                present = self.of(state.topic)
                if len(present) == 1:
                    state.publisher = present[0]

    def another_plant(self, state: TopicState, publisher: bytes) -> bool:
        """Whether, in a free graph, a new publisher shows that the plant was replaced.

        It publishes on a topic of the plant; or on a leading topic of a link, and the old plant no longer publishes.
        """
        if not self._options.free or state.common or state.publisher in (None, publisher) or self.plant is None:
            return False
        before = self.plant.publisher
        if before is None or (state.publisher or b"")[:NODE] == before[:NODE]:
            return before is not None
        present = self.of(self.plant.topic)
        return state.leads and bool(present) and before not in present

    def admit(self, state: TopicState, data: bytes, publisher: bytes) -> None:
        """Raise `Refused` for a message of a publisher that is not this graph's."""
        if publisher == state.publisher:
            return
        if not state.common:
            self._recognise(state, data, publisher)
        elif publisher[:NODE] not in self._nodes():
            self.know()
            if self._complete() and publisher[:NODE] not in self._nodes() | self._succeeding() | self._myself():
                raise Refused("publisher")

    def _recognise(self, state: TopicState, data: bytes, publisher: bytes) -> None:
        """Decide whether an unknown publisher is the topic's: the one that begins the run, else the only or first one.

        A successor is admitted, too. Raises `Refused` otherwise.
        """
        if state.publisher is None:
            self.know()
        if state.publisher is None and (state.reading.begins is None or state.reading.begins(data)):
            state.publisher = publisher
        if publisher != state.publisher and publisher[:NODE] not in self._succeeding(state):
            raise Refused("publisher")

    def _succeeding(self, state: TopicState | None = None) -> set[bytes]:
        """Nodes that may, unless in lockstep, succeed the publisher of a topic (of any topic if none is given).

        Either the publisher has left and the successor is the only one; or the publisher is silent and the successor
        has its name, since DDS takes 20 s to see that a node was killed. In real time the plant itself has no
        successor, and the others have none once it has left: the run is over then.
        """
        if self._options.paced and clock.monotonic() - self._sought_at > KNOW_S:
            self._sought_at = clock.monotonic()
            known = {topic_state.topic: topic_state for topic_state in self.topics if topic_state.publisher is not None}
            plant = known.get(self.plant.topic) if self.plant is not None else None
            over = plant is not None and plant.publisher not in self.of(plant.topic)
            heirs = {
                topic: self._heir(topic_state)
                for topic, topic_state in known.items()
                if self._options.free or not (over or self.is_plant(topic_state.publisher or b""))
            }
            self._heirs = {topic: heir for topic, heir in heirs.items() if heir is not None}
        return {gid[:NODE] for topic, gid in self._heirs.items() if state is None or topic == state.topic}

    def _heir(self, state: TopicState) -> bytes | None:
        """The only possible successor of a topic's publisher, if there is one."""
        present = self.of(state.topic)
        others = [publisher for publisher in present if publisher != state.publisher]
        if len(others) != 1:
            return None
        if state.publisher in present:
            if state.silent or clock.monotonic() - state.at < SILENT_S:
                return None
            endpoints = self._node.get_publishers_info_by_topic(state.topic)
            if len({(endpoint.node_namespace, endpoint.node_name) for endpoint in endpoints}) > 1:
                return None
        return others[0]

    def of(self, topic: str) -> list[bytes]:
        """Identities (GIDs) of all current publishers of a topic."""
        return [bytes(endpoint.endpoint_gid) for endpoint in self._node.get_publishers_info_by_topic(topic)]

    def _complete(self) -> bool:
        """Whether all publishers are known; until then an unknown node on a common topic may be this graph's."""
        return all(state.publisher is not None for state in self.topics if not state.common and not state.silent)

    def _nodes(self) -> set[bytes]:
        return {state.publisher[:NODE] for state in self.topics if state.publisher is not None}

    def _myself(self) -> set[bytes]:
        """GUID prefix of this node, from its own publisher of refusals: it may receive its own messages."""
        name, place = self._node.get_name(), self._node.get_namespace()
        present = self._node.get_publishers_info_by_topic(self._node.resolve_topic_name(f"{self._graph}{REFUSALS}"))
        return {
            bytes(end.endpoint_gid)[:NODE] for end in present if (end.node_name, end.node_namespace) == (name, place)
        }
