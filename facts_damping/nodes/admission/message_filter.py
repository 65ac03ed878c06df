"""Message filter: checks each message before it is used, and counts refusals.

A message must come from its topic's one publisher in this graph, have a newer sequence number of that publisher, pass
`read` (length, format, names, stamps), and belong to the next tick. A refused message changes nothing and ends no node.
"""

from __future__ import annotations

import sys
from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping_msgs.msg import RunState

from facts_damping.case.names import controller_addresses
from facts_damping.control.table import kind_of
from facts_damping.nodes import clock
from facts_damping.nodes.admission.publishers import BYTES, SILENT_S, Publishers, Reading, TopicState
from facts_damping.nodes.admission.refusals import Refusals
from facts_damping.nodes.base.discovery import pause_briefly, wait_for_peers
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.qos import DEPTH, LATCHED_SUBSCRIBER_QOS, SUBSCRIBER_QOS
from facts_damping.nodes.base.spinner import BeginAgain
from facts_damping.nodes.base.topics import PLANT_STATE, REFUSALS, RUN_STATE
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.cdr import Refused
from facts_damping.nodes.transport.messages import run_state
from facts_damping.nodes.transport.raw_take import take
from facts_damping.signals import start_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.qos import QoSProfile
    from rclpy.subscription import Subscription

    from facts_damping.case.model import Case
    from facts_damping.nodes.base.parameters import Options

NOTICED_S = SILENT_S + 0.2  # wall time within which peers notice that a node was killed
FOUND_S = 0.5  # wall time within which nodes discover each other on an idle machine
LOOK_S = 0.5  # wall time between two checks of which nodes are there
QUIET_S = 0.5  # wall time without a message after which an ended run is taken to send nothing more


class MessageFilter:
    """Subscribes for a node and passes on only admitted messages."""

    def __init__(
        self,
        node: Node,
        case: Case,
        options: Options,
        graph: str = "",
        send_refusals: Callable[[bytes], None] | None = None,
        *,
        peer: bool = True,
        leads: bool = False,
    ) -> None:
        """`graph`: prefix of the graph's topics (base/topics.py); `send_refusals`: takes reports instead of publishing.

        `peer`: the node is part of its graph; else it only listens, and no node waits for it. `leads`: it begins the
        run.
        """
        self.node, self.admitted_at = node, clock.monotonic()  # when a message was last admitted
        self.log, self._leads = NodeLog(node), leads
        self.over = False  # whether the plant has announced the end of the run
        self._rate, self._options = case.run.frame_rate, options
        users = zip(controller_addresses(case), case.controllers, strict=True)
        # Topics by whose publishers a node knows its peers: its own nodes', and those of users' nodes.
        self._of_peers = [REFUSALS, *(f"{address}/setpoints" for address, row in users if kind_of(row).node)]
        self._last = case.ticks - 1 if options.ends(case) and not options.free else sys.maxsize  # last tick
        self._graph = graph
        self.senders = Publishers(node, options, graph)
        self._subscriptions: list[Subscription[Any]] = []  # subscriptions made here
        self.refusals = Refusals(node, graph, send_refusals, peer=peer)
        self._peers: dict[str, bool] = {}  # nodes that have sent messages, and whether they are still there
        self._checked_at = 0.0

    def subscribe(
        self,
        kind: type[Any],
        topic: str,
        use: Callable[..., None],
        reading: Reading = BYTES,
        common: bool = False,
        plant: bool = False,
        leads: bool = False,
        qos: QoSProfile = SUBSCRIBER_QOS,
    ) -> None:
        """Subscribe to a topic. `common`: all nodes of the graph may publish there; `plant`: admit only the plant.

        `use` is called with what `reading` gives, or with the bytes and the middleware's message information.
        `leads`: the topic's ticks are the run's.
        """
        state = TopicState(self.node.resolve_topic_name(topic), reading, use, common, plant, leads)
        self.senders.topics.append(state)
        callback: Any = partial(self.take, state)  # returns whether the message was admitted, for the spinner
        self._subscriptions.append(self.node.create_subscription(kind, topic, callback, qos, raw=True))

    def subscribe_run_state(self, topic: str = PLANT_STATE) -> None:
        """Subscribe to the state of the run, which tells whether and why it has ended.

        The plant is the node that publishes `topic`.
        """
        self.senders.know_plant(topic)
        name, qos = f"{self._graph}{RUN_STATE}", LATCHED_SUBSCRIBER_QOS
        self.subscribe(RunState, name, self.on_run, Reading(run_state), common=True, plant=True, qos=qos)

    def on_run(self, state: int, in_synchronism: bool, reason: str) -> None:
        """Log why the run has ended. Reports of a pause only show that the plant is alive."""
        if state != RunState.ENDED or self.over:
            return
        self.over, text = True, " ".join(reason.split())
        if in_synchronism:
            self.log.info(f"the run has ended: {text}")
        else:
            self.log.error(text)

    def done(self) -> bool:
        """Whether the node should end: the run is over and messages have stopped.

        Always false in a free graph, and where a program runs the graph (parameter `progress`).
        """
        if self._options.free or self.log.lines or not self.over:
            return False
        return clock.monotonic() - self.admitted_at > QUIET_S

    def report_peers(self) -> None:
        """Log once for each sending node that it has joined, has left or is silent."""
        now = clock.monotonic()
        if self.over or now - self._checked_at < LOOK_S:
            return
        self._checked_at = now
        newest: dict[str, TopicState] = {}  # topic of the newest message, by node
        for state in sorted(self.senders.topics, key=lambda state: state.at):
            if state.publisher is not None and not state.common and state.tick >= 0:
                newest[self.senders.name(state.topic, state.publisher)] = state
        for name, state in newest.items():
            silent, others = now - state.at > SILENT_S, now - self.admitted_at < SILENT_S  # others send: no pause
            gone = silent and self.node.count_publishers(state.topic) == 0
            if not silent and not self._peers.get(name):
                self._peers[name] = True
                self.log.info(f"{name} has joined: tick {state.tick} of {state.topic}")
            elif self._peers.get(name) and (gone or (silent and others)):
                self._peers[name] = False
                what = "has left" if gone else "is silent"
                self.log.warning(f"{name} {what}: nothing of {state.topic} after tick {state.tick}")

    def wait_for_peers(self, expected: dict[Publisher[Any], int], serve: Callable[[], None]) -> None:
        """Wait for the graph's other nodes (base/discovery.py), then note the publishers of the topics.

        A node in mode free waits only until running nodes can have discovered it. In real time the node that begins
        the run does so as well, so that listeners receive the first frame. A joining node waits until peers have
        noticed that its predecessor is silent.
        """
        if not self._options.free:
            topics = [state.topic for state in self.senders.topics if not state.common and not state.silent]
            peers = [self.node.resolve_topic_name(f"{self._graph}{topic}") for topic in self._of_peers]
            wait_for_peers(self.node, expected, topics, peers, self._options, serve)
        if self._options.late or (self._options.paced and self._leads):
            until = clock.monotonic() + (NOTICED_S if self._options.join else FOUND_S)
            while clock.monotonic() < until:
                pause_briefly(serve)
        self.senders.know()
        if self._options.late:
            self._skip()

    def _skip(self) -> None:
        """Skip the messages that came while the node waited to join, except the newest of each publisher of a topic."""
        for subscription in self._subscriptions:
            newest: dict[bytes, Any] = {}
            for _ in range(DEPTH):
                message = take(subscription)
                if message is None:
                    break
                newest[message[1]["publisher_gid"]["data"]] = message
            for message in newest.values():
                subscription.callback(*message)

    def lost(self) -> dict[tuple[str, str], int]:
        """Number of missed messages, by topic and node."""
        counts: Counter[tuple[str, str]] = Counter()
        for state in self.senders.topics:
            for publisher, count in state.lost.items():
                counts[state.topic, self.senders.name(state.topic, publisher)] += count
        return counts

    def publishers(self) -> dict[str, str]:
        """Nodes whose messages were admitted, by `topic identity`."""
        return {
            f"{state.topic} {publisher.hex()}": self.senders.name(state.topic, publisher)
            for state in self.senders.topics
            for publisher in state.sequences
        }

    def take(self, state: TopicState, data: bytes, information: dict[str, Any]) -> bool:
        """Check a message and use it. Returns whether it was admitted."""
        publisher: bytes = information["publisher_gid"]["data"]
        if state.plant and not self.senders.is_plant(publisher):
            return False  # not for this node, and not counted as a refusal
        epoch = stamps.epoch_ns()
        try:
            self.senders.admit(state, data, publisher)
            if state.reading.check is not None:
                self._check_newer(state, state.reading.check(data)[0], publisher)
            self._count(state, publisher, information["publication_sequence_number"])
            if self.senders.another_plant(state, publisher):
                raise BeginAgain
            message: tuple[Any, ...] = (data, information) if state.reading.read is None else state.reading.read(data)
            if state.reading.read is not None and not state.common:
                self._check_tick(state, message[0], publisher)
        except Refused as refused:
            stamps.restore(epoch)  # a refused message must not set the epoch
            if publisher == state.publisher and not state.begun:
                state.publisher = None  # it was only taken for this graph's: as the first, or as the only one there
            self.refusals.add(state.topic, refused.cause, publisher)
            return False
        if not state.common:
            state.publisher = publisher  # may be a successor, since its first message passed all checks
        self.admitted_at = state.at = clock.monotonic()
        state.begun = True
        state.use(*message)
        return True

    def _count(self, state: TopicState, publisher: bytes, sequence: int | None) -> None:
        """Refuse a message that is older than one received from its publisher; count the missing ones."""
        if sequence is None:  # not every middleware numbers messages
            return
        self.senders.name(state.topic, publisher)  # look its name up now: it may have left by the time of the report
        newest = state.sequences.get(publisher, sequence - 1)
        if sequence <= newest:
            raise Refused("sequence")
        if sequence > newest + 1:
            state.lost[publisher] += sequence - newest - 1
        state.sequences[publisher] = sequence

    def _check_tick(self, state: TopicState, tick: int, publisher: bytes) -> None:
        """Refuse a tick that is not the next one; paced by the clock, ticks may be missing as far as time allows.

        A publisher whose first tick is not 0 belongs to an older graph and is forgotten, unless this node may be late.
        In a free graph, a new publisher with an earlier tick has begun a new run. Raises `BeginAgain` then.
        """
        if state.tick < 0 and tick > 0 and not self._options.late:
            raise Refused("publisher")
        if self._options.free and state.leads and tick < state.tick and publisher != state.publisher:
            raise BeginAgain
        late = int((1.0 + clock.monotonic() - state.at) * self._rate) if self._options.paced else 0
        latest = self._last if state.tick < 0 and self._options.late else state.tick + 1 + late
        if state.reading.newest is not None:
            latest = min(latest, state.reading.newest())
        if not state.tick < tick <= latest:
            raise Refused("tick")
        state.tick = tick

    def _check_newer(self, state: TopicState, tick: int, publisher: bytes) -> None:
        """Refuse a signed message of another publisher that is not newer: it may be one of this graph, sent again."""
        if publisher != state.publisher and tick <= state.checked:
            raise Refused("tick")
        state.checked = max(state.checked, tick)

    def refuse(self, topic: str, cause: str) -> None:
        """Count a refused request."""
        self.refusals.add(topic, cause)

    def report_refusals(self, last: bool = False) -> None:
        """Report refusals, at most once per second, and at the `last` call."""
        self.refusals.report(start_of(self.newest(), self._rate), last)

    def newest(self) -> int:
        """The newest tick of all topics; 0 before the first."""
        return max((state.tick for state in self.senders.topics if state.tick > 0), default=0)
