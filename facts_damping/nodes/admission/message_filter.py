"""What a node lets in: each message is checked before anything is done with it, and what is refused is counted.

A message must come from the one publisher of its topic that this graph has, be newer by that publisher's count, be
what `read` takes (length, format, names, stamps), and be of the next tick. Nothing else acts, and nobody ends of it.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from facts_damping_msgs.msg import RunState

from facts_damping.nodes.admission.publishers import PLANT, SILENT_S, Publishers, TopicState
from facts_damping.nodes.admission.refusals import Refusals
from facts_damping.nodes.base.discovery import pause_briefly, wait_for_peers
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.qos import DEPTH, LATCHED_SUBSCRIBER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.spinner import BeginAgain
from facts_damping.nodes.base.topics import STATE, TOPIC
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.nodes.transport.messages import run_state
from facts_damping.nodes.transport.raw_take import take
from facts_damping.nodes.transport.tables import start_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription

    from facts_damping.case.model import Case
    from facts_damping.nodes.base.parameters import Options

NOTICED_S = SILENT_S + 0.2  # wall time in which others have noticed that a node was killed
FOUND_S = 0.5  # wall time in which nodes find each other, if nothing else goes on
LOOK_S = 0.5  # wall time between two looks at who is there
QUIET_S = 0.5  # wall time without a message after which nothing more comes of a run that has ended


class MessageFilter:
    """Subscribes for a node, and lets through what may act."""

    def __init__(
        self,
        node: Node,
        case: Case,
        options: Options,
        graph: str = "",
        say: Callable[[bytes], None] | None = None,
        *,
        peer: bool = True,
        leads: bool = False,
    ) -> None:
        """`graph`: what leads from the node to the topics of its graph (node.py); `say`: takes reports, if not all.

        `peer`: the node is one of its graph; else it only listens, and nobody waits for it. `leads`: it begins the run.
        """
        self.node, self.heard = node, time.monotonic()  # when something was last let through
        self.log, self._leads = NodeLog(node), leads
        self.over = False  # whether the plant has said that the run has ended
        self._rate, self._options = case.run.frame_rate, options
        self._last = sys.maxsize if options.free else case.ticks - 1  # tick that the run has at most
        self._graph = graph
        self.who = Publishers(node, options, graph)
        self._own: list[Subscription[Any]] = []  # what was subscribed to here
        self.refusals = Refusals(node, graph, say, peer=peer)
        self._there: dict[str, bool] = {}  # nodes that have been heard, and whether they are still there
        self._looked_at = 0.0

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
        qos: QoSProfile = SUBSCRIBER_QOS,
    ) -> None:
        """Listen to a topic; `common`: all nodes of the graph may speak there; `plant`: it alone is heard.

        `read` makes of a message its tick (none on a topic that all share) and more, or raises `Refused`; `use` is
        called with that; without `read` it gets the bytes and what the middleware knows of them. `newest`: the newest
        tick that it may be of. `begins`: whether a message is the first of a run: its publisher is this graph's.
        `leads`: its ticks are the run's.
        """
        heard = TopicState(self.node.resolve_topic_name(topic), read, newest, use, begins, common, plant, leads)
        self.who.topics.append(heard)

        def take(data: bytes, information: Any) -> bool:
            return self.take(heard, data, information)

        taking: Any = take  # the spinner wants to know whether a message was let through
        self._own.append(self.node.create_subscription(kind, topic, taking, qos, raw=True))

    def hear_run(self, topic: str = PLANT) -> None:
        """Hear from the plant how the run stands: whether it is over, and why.

        The plant is who publishes `topic`.
        """
        self.who.know_plant(topic)
        self.subscribe(
            RunState,
            f"{self._graph}{STATE}",
            self.on_run,
            run_state,
            common=True,
            plant=True,
            qos=LATCHED_SUBSCRIBER_QOS,
        )

    def on_run(self, state: int, in_synchronism: bool, reason: str) -> None:
        """Say why a run has ended; a pause is told so that nobody takes it for a plant that is silent."""
        if state != RunState.ENDED or self.over:
            return
        self.over, text = True, " ".join(reason.split())
        if in_synchronism:
            self.log.info(f"the run has ended: {text}")
        else:
            self.log.error(text)

    def done(self) -> bool:
        """Whether the run has ended and nothing more comes: then a node ends, if nobody supervises it."""
        if self._options.free or self.log.lines or not self.over:
            return False
        return time.monotonic() - self.heard > QUIET_S

    def who_is_there(self) -> None:
        """Say, once, of each node that is heard, that it has joined, or that it has left or is silent."""
        now = time.monotonic()
        if self.over or now - self._looked_at < LOOK_S:
            return
        self._looked_at = now
        newest: dict[str, TopicState] = {}  # topic of each node by which something has come last
        for heard in sorted(self.who.topics, key=lambda one: one.at):
            if heard.publisher is not None and not heard.common and heard.tick >= 0:
                newest[self.who.name(heard.topic, heard.publisher)] = heard
        for name, heard in newest.items():
            silent, others = now - heard.at > SILENT_S, now - self.heard < SILENT_S  # others go on: no pause
            gone = silent and self.node.count_publishers(heard.topic) == 0
            if not silent and not self._there.get(name):
                self._there[name] = True
                self.log.info(f"{name} has joined: tick {heard.tick} of {heard.topic}")
            elif self._there.get(name) and (gone or (silent and others)):
                self._there[name] = False
                what = "has left" if gone else "is silent"
                self.log.warning(f"{name} {what}: nothing of {heard.topic} after tick {heard.tick}")

    def wait_for_peers(self, expected: dict[Publisher[Any], int], serve: Callable[[], None]) -> None:
        """Wait until the graph is there (node.py); whose its topics are is known from then on.

        Who runs free waits for nobody, only until those who are there can have found it. So does, in real time, who
        begins the run: whoever only listens hears it from the first frame on. Who joins waits until others have noticed
        that the one before it is silent.
        """
        if not self._options.free:
            heard = [one.topic for one in self.who.topics if not one.common and not one.silent]
            peers = f"{self._graph}{TOPIC}"
            wait_for_peers(self.node, expected, heard, self.node.resolve_topic_name(peers), self._options, serve)
        if self._options.late or (self._options.paced and self._leads):
            until = time.monotonic() + (NOTICED_S if self._options.join else FOUND_S)
            while time.monotonic() < until:
                pause_briefly(serve)
        self.who.know()
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
        for heard in self.who.topics:
            for publisher, count in heard.lost.items():
                counts[heard.topic, self.who.name(heard.topic, publisher)] += count
        return counts

    def publishers(self) -> dict[str, str]:
        """Nodes whose messages were let in, by `topic identity`."""
        return {
            f"{heard.topic} {publisher.hex()}": self.who.name(heard.topic, publisher)
            for heard in self.who.topics
            for publisher in heard.sequences
        }

    def take(self, heard: TopicState, data: bytes, information: dict[str, Any]) -> bool:
        """Take a message; whether it was let through."""
        publisher: bytes = information["publisher_gid"]["data"]
        if heard.plant and not self.who.is_plant(publisher):
            return False  # not for this node: who listens to all says what is nobody's
        epoch = stamps.epoch_ns()
        try:
            self.who.admit(heard, data, publisher)
            self._count(heard, publisher, information["publication_sequence_number"])
            if self.who.another_plant(heard, publisher):
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

    def _count(self, heard: TopicState, publisher: bytes, sequence: int | None) -> None:
        """Refuse a message that its publisher sent before one that has come; count those that did not come."""
        if sequence is None:  # not every middleware counts
            return
        if publisher not in self.who.names:
            self.who.name(heard.topic, publisher)  # it may have left when it is told
        newest = heard.sequences.get(publisher, sequence - 1)
        if sequence <= newest:
            raise Refused("sequence")
        if sequence > newest + 1:
            heard.lost[publisher] += sequence - newest - 1
        heard.sequences[publisher] = sequence

    def _check_tick(self, heard: TopicState, tick: int, publisher: bytes) -> None:
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
        return max((heard.tick for heard in self.who.topics if heard.tick > 0), default=0)

    def remark(self) -> str:
        """What to add to an error, where others are at it: a silent node may be one that is not listened to."""
        foreign = self.refusals.foreign()
        if not foreign:
            return ""
        return f"; {foreign} messages of others were refused: another graph in this ROS_DOMAIN_ID (0 to 101)?"
