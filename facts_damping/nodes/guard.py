"""What a node lets in: each message is checked before anything is done with it, and what is refused is counted.

A message must come from the one publisher of its topic that this graph has, be newer by that publisher's count, be
what `read` takes (length, format, names, stamps), and be of the next tick. Nothing else acts, and nobody ends of it.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from facts_damping_msgs.msg import RefusedCount, RefusedMessages
from rclpy.serialization import serialize_message

from facts_damping.nodes.cdr import Refused
from facts_damping.nodes.messages import errors, set_time
from facts_damping.nodes.node import COMMON, DEPTH, HEARING, SAYING, wait_for_peers
from facts_damping.nodes.tables import start_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.publisher import Publisher

    from facts_damping.case.model import Case
    from facts_damping.nodes.parameters import Options

TOPIC = "security/refused"  # of every graph: what its nodes have refused
TELL_S = 1.0  # wall time between two reports at least
KNOW_S = 0.01  # wall time between two looks at who publishes, at least
PLANT = "plant/state"  # who publishes it is the plant
MOST = 200  # counts by topic, cause and source that are kept apart; what comes on top is counted as of others
OTHERS = b""
UNKNOWN = "_NODE_NAME_UNKNOWN_"  # what the middleware calls a node that it has not heard of yet
NODE = 12  # first bytes of a publisher's identity that all of a node's have: the GUID prefix (RTPS 2.5, 8.2.4.1)


@dataclass
class Heard:
    """A topic that is listened to, and what has come by it."""

    topic: str
    read: Callable[[bytes], tuple[Any, ...]] | None
    newest: Callable[[], int] | None
    use: Callable[..., None]
    begins: Callable[[bytes], bool] | None
    common: bool
    plant: bool = False  # the plant alone is heard, where all may speak
    silent: bool = False  # not subscribed to: only its publisher is known
    publisher: bytes | None = None  # identity of who publishes it in this graph, once that is known
    sequences: dict[bytes, int] = field(default_factory=dict)  # of the newest message, by publisher
    lost: Counter[bytes] = field(default_factory=Counter)  # messages that did not come, by the gaps of those
    tick: int = -1  # of the newest message
    at: float = field(default_factory=time.monotonic)  # when it came


class Guard:
    """Subscribes for a node, and lets through what may act."""

    def __init__(
        self, node: Node, case: Case, options: Options, graph: str = "", say: Callable[[bytes], None] | None = None
    ) -> None:
        """`graph`: what leads from the node to the topics of its graph (node.py); `say`: takes reports, if not all."""
        self.node, self.heard = node, time.monotonic()  # when something was last let through
        self.over = False  # whether the plant has said that it is lost
        self._rate, self._ticks, self._options = case.run.frame_rate, case.ticks, options
        self._graph = graph
        self._plant: Heard | None = None  # a topic that the plant publishes
        self._topics: list[Heard] = []
        self._say = say or node.create_publisher(RefusedMessages, f"{graph}{TOPIC}", SAYING).publish
        self._refused: Counter[tuple[str, str, bytes]] = Counter()  # by topic, cause, publisher
        self._told: Counter[tuple[str, str, str]] = Counter()  # by topic, cause, source
        self._sources = {OTHERS: "others"}  # of publishers that were refused: what they were told as
        self._told_at = self._looked_at = self._sought_at = 0.0
        self._heirs: dict[str, bytes] = {}  # by topic: who is alone where its publisher has left

    def subscribe(
        self,
        kind: type[Any],
        topic: str,
        use: Callable[..., None],
        read: Callable[[bytes], tuple[Any, ...]] | None = None,
        newest: Callable[[], int] | None = None,
        begins: Callable[[bytes], bool] | None = None,
        common: bool = False,
        plant: bool = False,
    ) -> None:
        """Listen to a topic; `common`: all nodes of the graph may speak there; `plant`: it alone is heard.

        `read` makes of a message its tick (none on a topic that all share) and more, or raises `Refused`; `use` is
        called with that; without `read` it gets the bytes and what the middleware knows of them. `newest`: the newest
        tick that it may be of. `begins`: whether a message is the first of a run: its publisher is this graph's.
        """
        heard = Heard(self.node.resolve_topic_name(topic), read, newest, use, begins, common, plant)
        self._topics.append(heard)

        def take(data: bytes, information: Any) -> bool:
            return self.take(heard, data, information)

        taking: Any = take  # the spinner wants to know whether a message was let through
        self.node.create_subscription(kind, topic, taking, HEARING, raw=True)

    def know_plant(self, topic: str = PLANT) -> None:
        """Know the plant by a topic that it publishes, whether that is listened to or not."""
        name = self.node.resolve_topic_name(f"{self._graph}{topic}")
        self._plant = next((heard for heard in self._topics if heard.topic == name), None)
        if self._plant is None:
            self._plant = Heard(name, None, None, _nothing, None, common=False, silent=True)
            self._topics.append(self._plant)

    def hear_errors(self, topic: str = PLANT) -> None:
        """Repeat what the plant says of errors, a loss of synchronism above all; `over` is true from then on.

        The plant is who publishes `topic`.
        """
        self.know_plant(topic)
        self.subscribe(DiagnosticArray, COMMON, self.repeat, errors, common=True, plant=True)

    def repeat(self, told: list[str]) -> None:
        """Say what the plant says, a line each."""
        for text in told:
            self.over = True
            sys.stdout.write(f"{' '.join(text.split())}\n")
            sys.stdout.flush()

    def is_plant(self, publisher: bytes) -> bool:
        """Whether a publisher is of the plant's node."""
        if self._plant is not None and self._plant.publisher is None:
            self._know()
        known = self._plant.publisher if self._plant is not None else None
        return known is not None and publisher[:NODE] == known[:NODE]

    def wait_for_peers(self, expected: dict[Publisher[Any], int]) -> None:
        """Wait until the graph is there (node.py); whose its topics are is known from then on."""
        heard = [one.topic for one in self._topics if not one.common and not one.silent]
        wait_for_peers(self.node, expected, heard, self._options)
        self._know()
        if self._options.join:
            self._skip()

    def _skip(self) -> None:
        """Pass over what came while a node waited to join, but for the newest message of each topic."""
        for subscription in self.node.subscriptions:
            newest: Any = None
            for _ in range(DEPTH):
                taken: Any = subscription.handle.take_message(subscription.msg_type, subscription.raw)
                if taken is None:
                    break
                newest = taken
            if newest is not None:
                subscription.callback(*newest)

    def lost(self) -> dict[tuple[str, str], int]:
        """How many messages were missed, by topic and publisher."""
        counts: Counter[tuple[str, str]] = Counter()
        for heard in self._topics:
            for publisher, count in heard.lost.items():
                counts[heard.topic, self._source(heard.topic, publisher)] += count
        return counts

    def _know(self) -> None:
        """Look who publishes: the only one is this graph's, for good."""
        if time.monotonic() - self._looked_at < KNOW_S:
            return
        self._looked_at = time.monotonic()
        for heard in self._topics:
            if heard.publisher is None and heard.begins is None and not heard.common:
                there = self._publishers(heard.topic)
                if len(there) == 1:
                    heard.publisher = there[0]

    def take(self, heard: Heard, data: bytes, information: dict[str, Any]) -> bool:
        """Take a message; whether it was let through."""
        publisher: bytes = information["publisher_gid"]["data"]
        if heard.plant and not self.is_plant(publisher):
            return False  # not for this node: who listens to all says what is nobody's
        try:
            self._admit(heard, data, publisher)
            self._count(heard, publisher, information["publication_sequence_number"])
            if heard.read is None:
                message: tuple[Any, ...] = (data, information)
            else:
                message = heard.read(data)
                if not heard.common:
                    self._check_tick(heard, message[0])
        except Refused as refused:
            self.refuse(heard.topic, refused.cause, publisher)
            return False
        if not heard.common:
            heard.publisher = publisher  # also a successor's, whose first message is sound
        self.heard = heard.at = time.monotonic()
        heard.use(*message)
        return True

    def _admit(self, heard: Heard, data: bytes, publisher: bytes) -> None:
        """Refuse a message of somebody else's."""
        if publisher == heard.publisher:
            return
        if not heard.common:
            self._recognise(heard, data, publisher)
        elif publisher[:NODE] not in self._nodes():
            self._know()
            if self._complete() and publisher[:NODE] not in self._nodes() | self._succeeding():
                raise Refused("publisher")

    def _count(self, heard: Heard, publisher: bytes, sequence: int | None) -> None:
        """Refuse a message that its publisher sent before one that has come; count those that did not come."""
        if sequence is None:  # not every middleware counts
            return
        newest = heard.sequences.get(publisher, sequence - 1)
        if sequence <= newest:
            raise Refused("sequence")
        if sequence > newest + 1:
            heard.lost[publisher] += sequence - newest - 1
            self._source(heard.topic, publisher)  # it may have left when that is told
        heard.sequences[publisher] = sequence

    def _recognise(self, heard: Heard, data: bytes, publisher: bytes) -> None:
        """Whose a topic is, when a message comes before that is known: who begins, else who is alone or first."""
        if heard.publisher is None:
            self._know()
        if heard.publisher is None and (heard.begins is None or heard.begins(data)):
            heard.publisher = publisher
        if publisher != heard.publisher and publisher[:NODE] not in self._succeeding(heard):
            raise Refused("publisher")

    def _succeeding(self, heard: Heard | None = None) -> set[bytes]:
        """Nodes that, in real time, are alone on a topic (on any, if none is given) whose publisher has left.

        As long as the plant is there: without it the run is over, and it has no successor.
        """
        if self._options.realtime and time.monotonic() - self._sought_at > KNOW_S:
            self._sought_at = time.monotonic()
            known = {one.topic: one.publisher for one in self._topics if one.publisher is not None}
            there = {topic: self._publishers(topic) for topic in known}
            plant = self._plant.topic if self._plant is not None else ""
            over = plant in known and known[plant] not in there[plant]
            self._heirs = {
                topic: own[0]
                for topic, own in there.items()
                if not over and len(own) == 1 and own[0] != known[topic] and not self.is_plant(known[topic])
            }
        return {gid[:NODE] for topic, gid in self._heirs.items() if heard is None or topic == heard.topic}

    def _publishers(self, topic: str) -> list[bytes]:
        return [bytes(one.endpoint_gid) for one in self.node.get_publishers_info_by_topic(topic)]

    def _complete(self) -> bool:
        """Whether all nodes are known: until then one that speaks on a common topic first may be this graph's."""
        return all(heard.publisher is not None for heard in self._topics if not heard.common and not heard.silent)

    def _nodes(self) -> set[bytes]:
        return {heard.publisher[:NODE] for heard in self._topics if heard.publisher is not None}

    def _check_tick(self, heard: Heard, tick: int) -> None:
        """Refuse a tick that is not the next one; in real time as many may be missing as the clock allows.

        Who does not begin with tick 0 is of another graph, that was there before: then the publisher is unknown again.
        """
        if heard.tick < 0 and tick > 0 and not self._options.join:
            heard.publisher = None
            raise Refused("publisher")
        late = int((1.0 + time.monotonic() - heard.at) * self._rate) if self._options.realtime else 0
        latest = self._ticks - 1 if heard.tick < 0 and self._options.join else heard.tick + 1 + late
        if heard.newest is not None:
            latest = min(latest, heard.newest())
        if not heard.tick < tick <= latest:
            raise Refused("tick")
        heard.tick = tick

    def refuse(self, topic: str, cause: str, publisher: bytes = OTHERS) -> None:
        """Count a message or request that was refused."""
        if not self._refused:
            self._told_at = time.monotonic()  # who a newcomer is, one hears after what it says
        if len(self._refused) < MOST or (topic, cause, publisher) in self._refused:
            self._refused[topic, cause, publisher] += 1
        else:
            self._refused[topic, cause, OTHERS] += 1

    def _source(self, topic: str, publisher: bytes) -> str:
        """How a publisher calls itself, once and for all: its node's full name, else its identity."""
        if publisher not in self._sources:
            there = self.node.get_publishers_info_by_topic(topic)
            one = next((one for one in there if bytes(one.endpoint_gid) == publisher), None)
            known = one is not None and one.node_name != UNKNOWN
            name = f"{one.node_namespace.rstrip('/')}/{one.node_name}" if one and known else publisher.hex()
            self._sources[publisher] = "".join(c if c.isprintable() and not c.isspace() else "?" for c in name)
        return self._sources[publisher]

    def tell(self, last: bool = False) -> None:
        """Report what is new: lines `refused N CAUSE TOPIC SOURCE` on standard output, and a message.

        At most once in `TELL_S`, unless it is the last time.
        """
        if self._told.total() == self._refused.total() or not (last or time.monotonic() - self._told_at > TELL_S):
            return
        self._told_at = time.monotonic()
        counts: Counter[tuple[str, str, str]] = Counter()
        for (topic, cause, publisher), count in self._refused.items():
            counts[topic, cause, self._source(topic, publisher)] += count
        for (topic, cause, source), count in counts.items():
            if count != self._told[topic, cause, source]:
                sys.stdout.write(f"refused {count} {cause} {topic} {source}\n")
        sys.stdout.flush()
        self._told = counts
        message = RefusedMessages(node=self.node.get_fully_qualified_name())
        newest = max((heard.tick for heard in self._topics), default=0)
        set_time(message.header.stamp, start_of(max(newest, 0), self._rate))
        message.refused = [
            RefusedCount(topic=topic, cause=cause, source=source, count=count)
            for (topic, cause, source), count in counts.items()
        ]
        self._say(serialize_message(message))

    def remark(self) -> str:
        """What to add to an error, where others are at it: a silent node may be one that is not listened to."""
        foreign = sum(count for (_, cause, _), count in self._refused.items() if cause == "publisher")
        if not foreign:
            return ""
        return f"; {foreign} messages of others were refused: another graph in this ROS_DOMAIN_ID (0 to 101)?"


def _nothing() -> None:
    """For a topic that nothing is heard of."""
