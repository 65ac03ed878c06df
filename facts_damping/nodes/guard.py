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

from facts_damping_msgs.msg import RunState

from facts_damping.nodes import stamps
from facts_damping.nodes.cdr import Refused
from facts_damping.nodes.messages import run_state
from facts_damping.nodes.node import (
    DEPTH,
    HEARING,
    HEARING_LATE,
    NODE,
    STATE,
    TOPIC,
    Voice,
    rest,
    wait_for_peers,
)
from facts_damping.nodes.refusals import Refusals, node_name
from facts_damping.nodes.spinning import BeginAgain
from facts_damping.nodes.tables import start_of
from facts_damping.nodes.taking import take

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription

    from facts_damping.case.model import Case
    from facts_damping.nodes.parameters import Options

KNOW_S = 0.01  # wall time between two looks at who publishes, at least
PLANT = "plant/state"  # who publishes it is the plant
FOUND_S = 0.5  # wall time in which nodes find each other, if nothing else goes on
QUIET_S = 0.5  # wall time without a message after which nothing more comes of a run that has ended


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
    leads: bool = False  # frames: who is new there with an earlier tick begins another run
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
        self.voice = Voice(node)
        self.over = False  # whether the plant has said that the run has ended
        self._rate, self._options = case.run.frame_rate, options
        self._last = sys.maxsize if options.free else case.ticks - 1  # tick that the run has at most
        self._graph = graph
        self._plant: Heard | None = None  # a topic that the plant publishes
        self._topics: list[Heard] = []
        self._own: list[Subscription[Any]] = []  # what was subscribed to here
        self.refusals = Refusals(node, graph, say)
        self._names: dict[bytes, str] = {}  # of nodes whose messages were let in, by publisher
        self._looked_at = self._sought_at = 0.0
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
        leads: bool = False,
        qos: QoSProfile = HEARING,
    ) -> None:
        """Listen to a topic; `common`: all nodes of the graph may speak there; `plant`: it alone is heard.

        `read` makes of a message its tick (none on a topic that all share) and more, or raises `Refused`; `use` is
        called with that; without `read` it gets the bytes and what the middleware knows of them. `newest`: the newest
        tick that it may be of. `begins`: whether a message is the first of a run: its publisher is this graph's.
        `leads`: its ticks are the run's.
        """
        heard = Heard(self.node.resolve_topic_name(topic), read, newest, use, begins, common, plant, leads)
        self._topics.append(heard)

        def take(data: bytes, information: Any) -> bool:
            return self.take(heard, data, information)

        taking: Any = take  # the spinner wants to know whether a message was let through
        self._own.append(self.node.create_subscription(kind, topic, taking, qos, raw=True))

    def know_plant(self, topic: str = PLANT) -> None:
        """Know the plant by a topic that it publishes, whether that is listened to or not."""
        name = self.node.resolve_topic_name(f"{self._graph}{topic}")
        self._plant = next((heard for heard in self._topics if heard.topic == name), None)
        if self._plant is None:
            self._plant = Heard(name, None, None, _nothing, None, common=False, silent=True)
            self._topics.append(self._plant)

    def hear_run(self, topic: str = PLANT) -> None:
        """Hear from the plant how the run stands: whether it is over, and why.

        The plant is who publishes `topic`.
        """
        self.know_plant(topic)
        self.subscribe(
            RunState, f"{self._graph}{STATE}", self.on_run, run_state, common=True, plant=True, qos=HEARING_LATE
        )

    def on_run(self, state: int, in_synchronism: bool, reason: str) -> None:
        """Say why a run has ended; a pause is told so that nobody takes it for a plant that is silent."""
        if state != RunState.ENDED or self.over:
            return
        self.over, text = True, " ".join(reason.split())
        if in_synchronism:
            self.voice.info(f"the run has ended: {text}")
        else:
            self.voice.alarm(text)

    def done(self) -> bool:
        """Whether the run has ended and nothing more comes: then a node ends, if nobody supervises it."""
        if self._options.free or self.voice.lines or not self.over:
            return False
        return time.monotonic() - self.heard > QUIET_S

    def is_plant(self, publisher: bytes) -> bool:
        """Whether a publisher is of the plant's node."""
        if self._plant is not None and self._plant.publisher is None:
            self._know()
        known = self._plant.publisher if self._plant is not None else None
        return known is not None and publisher[:NODE] == known[:NODE]

    def wait_for_peers(self, expected: dict[Publisher[Any], int], serve: Callable[[], None]) -> None:
        """Wait until the graph is there (node.py); whose its topics are is known from then on.

        Who runs free waits for nobody, only until those who are there can have found it.
        """
        if self._options.free:
            until = time.monotonic() + FOUND_S
            while time.monotonic() < until:
                rest(serve)
        else:
            heard = [one.topic for one in self._topics if not one.common and not one.silent]
            peers = f"{self._graph}{TOPIC}"
            wait_for_peers(self.node, expected, heard, self.node.resolve_topic_name(peers), self._options, serve)
        self._know()
        if self._options.late:
            self._skip()

    def _skip(self) -> None:
        """Pass over what came while a node waited to join, but for the newest message of each topic."""
        for subscription in self._own:
            newest: Any = None
            for _ in range(DEPTH):
                taken = take(subscription)
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
                counts[heard.topic, self._name(heard.topic, publisher)] += count
        return counts

    def publishers(self) -> dict[str, str]:
        """Nodes whose messages were let in, by `topic identity`."""
        return {
            f"{heard.topic} {publisher.hex()}": self._name(heard.topic, publisher)
            for heard in self._topics
            for publisher in heard.sequences
        }

    def _name(self, topic: str, publisher: bytes) -> str:
        """The node of a publisher, kept once it is known; until then its identity."""
        if publisher not in self._names and (name := node_name(self.node, topic, publisher)):
            self._names[publisher] = name
        return self._names.get(publisher, publisher.hex())

    def _myself(self) -> set[bytes]:
        """This node, as others know it: where it hears on a topic on which it speaks."""
        name, place = self.node.get_name(), self.node.get_namespace()
        there = self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(f"{self._graph}{TOPIC}"))
        return {bytes(one.endpoint_gid)[:NODE] for one in there if (one.node_name, one.node_namespace) == (name, place)}

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
        epoch = stamps.epoch_ns()
        try:
            self._admit(heard, data, publisher)
            self._count(heard, publisher, information["publication_sequence_number"])
            if self._another_plant(heard, publisher):
                raise BeginAgain
            if heard.read is None:
                message: tuple[Any, ...] = (data, information)
            else:
                message = heard.read(data)
                if not heard.common:
                    self._check_tick(heard, message[0], publisher)
        except Refused as refused:
            stamps.restore(epoch)  # what is refused has taught nothing
            self.refusals.add(heard.topic, refused.cause, publisher)
            return False
        if not heard.common:
            heard.publisher = publisher  # also a successor's, whose first message is sound
        self.heard = heard.at = time.monotonic()
        heard.use(*message)
        return True

    def _another_plant(self, heard: Heard, publisher: bytes) -> bool:
        """Whether somebody new speaks where the plant did; or for a link, and the plant is another one by now."""
        if not self._options.free or heard.common or heard.publisher in (None, publisher) or self._plant is None:
            return False
        before = self._plant.publisher
        if before is None or (heard.publisher or b"")[:NODE] == before[:NODE]:
            return before is not None
        there = self._publishers(self._plant.topic)
        return heard.leads and bool(there) and before not in there

    def _admit(self, heard: Heard, data: bytes, publisher: bytes) -> None:
        """Refuse a message of somebody else's."""
        if publisher == heard.publisher:
            return
        if not heard.common:
            self._recognise(heard, data, publisher)
        elif publisher[:NODE] not in self._nodes():
            self._know()
            if self._complete() and publisher[:NODE] not in self._nodes() | self._succeeding() | self._myself():
                raise Refused("publisher")

    def _count(self, heard: Heard, publisher: bytes, sequence: int | None) -> None:
        """Refuse a message that its publisher sent before one that has come; count those that did not come."""
        if sequence is None:  # not every middleware counts
            return
        if publisher not in self._names:
            self._name(heard.topic, publisher)  # it may have left when it is told
        newest = heard.sequences.get(publisher, sequence - 1)
        if sequence <= newest:
            raise Refused("sequence")
        if sequence > newest + 1:
            heard.lost[publisher] += sequence - newest - 1
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
        """Nodes that, unless in lockstep, are alone on a topic (on any, if none is given) whose publisher has left.

        In real time as long as the plant is there: without it the run is over, and it has no successor.
        """
        if self._options.paced and time.monotonic() - self._sought_at > KNOW_S:
            self._sought_at = time.monotonic()
            known = {one.topic: one.publisher for one in self._topics if one.publisher is not None}
            there = {topic: self._publishers(topic) for topic in known}
            plant = self._plant.topic if self._plant is not None else ""
            over = plant in known and known[plant] not in there[plant]
            self._heirs = {
                topic: own[0]
                for topic, own in there.items()
                if len(own) == 1 and own[0] != known[topic]
                if self._options.free or not (over or self.is_plant(known[topic]))
            }
        return {gid[:NODE] for topic, gid in self._heirs.items() if heard is None or topic == heard.topic}

    def _publishers(self, topic: str) -> list[bytes]:
        return [bytes(one.endpoint_gid) for one in self.node.get_publishers_info_by_topic(topic)]

    def _complete(self) -> bool:
        """Whether all nodes are known: until then one that speaks on a common topic first may be this graph's."""
        return all(heard.publisher is not None for heard in self._topics if not heard.common and not heard.silent)

    def _nodes(self) -> set[bytes]:
        return {heard.publisher[:NODE] for heard in self._topics if heard.publisher is not None}

    def _check_tick(self, heard: Heard, tick: int, publisher: bytes) -> None:
        """Refuse a tick that is not the next one; by the clock as many may be missing as that allows.

        Who does not begin with tick 0 is of another graph, that was there before: then the publisher is unknown again.
        Where the graph runs free, somebody new with an earlier tick is of a new run, for which the node begins again.
        """
        if heard.tick < 0 and tick > 0 and not self._options.late:
            heard.publisher = None
            raise Refused("publisher")
        if self._options.free and heard.leads and tick < heard.tick and publisher != heard.publisher:
            raise BeginAgain
        late = int((1.0 + time.monotonic() - heard.at) * self._rate) if self._options.paced else 0
        latest = self._last if heard.tick < 0 and self._options.late else heard.tick + 1 + late
        if heard.newest is not None:
            latest = min(latest, heard.newest())
        if not heard.tick < tick <= latest:
            raise Refused("tick")
        heard.tick = tick

    def refuse(self, topic: str, cause: str) -> None:
        """Count a request that was refused."""
        self.refusals.add(topic, cause)

    def tell(self, last: bool = False) -> None:
        """Report what was refused, now and then, or for the `last` time."""
        self.refusals.tell(start_of(self.newest(), self._rate), last)

    def newest(self) -> int:
        """The newest tick that the node has heard of; 0 before the first."""
        return max((heard.tick for heard in self._topics if heard.tick > 0), default=0)

    def remark(self) -> str:
        """What to add to an error, where others are at it: a silent node may be one that is not listened to."""
        foreign = self.refusals.foreign()
        if not foreign:
            return ""
        return f"; {foreign} messages of others were refused: another graph in this ROS_DOMAIN_ID (0 to 101)?"


def _nothing() -> None:
    """For a topic that nothing is heard of."""
