"""Discovery: waits for the peers of a node and detects other graphs in the domain."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.qos import QoSReliabilityPolicy

from facts_damping.errors import RunError
from facts_damping.nodes import clock
from facts_damping.nodes.base.log import NodeLog
from facts_damping.nodes.base.spinner import check_wanted
from facts_damping.nodes.base.topics import SHARED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.topic_endpoint_info import TopicEndpointInfo

    from facts_damping.nodes.base.parameters import Options

BAG = "rosbag2_recorder"  # name of the node of `ros2 bag record`
NODE = 12  # leading bytes of a publisher's identity (GID) that are the same for all endpoints of a node
LOOK_S = 0.1  # longest wall time between two looks at the peers of a node that waits for them
PATIENT_S = 1.0  # wall time after which a node logs what it waits for


def shared_topic(publishers: Mapping[str, Sequence[TopicEndpointInfo]], *, joins: bool) -> str | None:
    """The first topic with more publishers than the one that a graph has; None if there is none.

    `joins`: publishers of the same node name count once, as the node's predecessor may still be there.
    """
    for topic, there in publishers.items():
        names = {(endpoint.node_namespace, endpoint.node_name) for endpoint in there}
        if not topic.endswith(SHARED) and (len(names) if joins else len(there)) > 1:
            return topic
    return None


def wait_for_peers(
    node: Node,
    expected: dict[Publisher[Any], int],
    topics: Sequence[str],
    peers: Sequence[str],
    options: Options,
    serve: Callable[[], None],
) -> None:
    """Wait until every publisher has its `expected` subscribers and every topic of `topics` a publisher.

    Only subscribers of peers count: nodes that publish on a topic of `topics` or of `peers`. A joining node also waits
    until publishers with another name have left. `serve` answers requests meanwhile.
    Raises `RunError` if another graph publishes the same topics, or names what is missing after the time-out.
    """
    log, logged = NodeLog(node), False
    deadline = clock.monotonic() + options.start_timeout
    published = list(dict.fromkeys([*topics, *(publisher.topic_name for publisher in expected)]))
    counts, looked_at = list[int](), -LOOK_S
    missing, shared = list[str](), None
    while True:
        before, counts = counts, _counts(node, expected, [*published, *peers])
        now = clock.monotonic()
        if counts != before or now - looked_at > LOOK_S or now > deadline:
            looked_at = now
            there = {topic: node.get_publishers_info_by_topic(topic) for topic in published}
            missing = _missing(node, expected, topics, peers, there, options)
            shared = shared_topic(there, joins=options.join)
        late = now > deadline
        if shared is not None and (late or not options.join):
            raise RunError(f"another graph publishes {shared} too; set another ROS_DOMAIN_ID (0 to 101)")
        if not missing and shared is None:
            return
        if not logged and clock.monotonic() > deadline - options.start_timeout + PATIENT_S:
            logged = True
            what = ", ".join(missing) or f"the other publisher of {shared} to leave"
            log.info(f"waits, {options.start_timeout:g} s at most, for {what}")
        if late:
            raise RunError(f"missing after {options.start_timeout:g} s: {', '.join(missing)}")
        pause_briefly(serve)


def _counts(node: Node, expected: Iterable[Publisher[Any]], topics: Sequence[str]) -> list[int]:
    """Numbers of publishers and readers, which cost much less than to ask who they are."""
    readers = [(end.get_subscription_count(), node.count_subscribers(end.topic_name)) for end in expected]
    return [*(node.count_publishers(topic) for topic in topics), *(count for pair in readers for count in pair)]


def _missing(
    node: Node,
    expected: dict[Publisher[Any], int],
    topics: Sequence[str],
    peers: Sequence[str],
    there: Mapping[str, Sequence[TopicEndpointInfo]],
    options: Options,
) -> list[str]:
    """What `wait_for_peers` still waits for; `there`: publishers by topic."""
    participants = {_participant(endpoint) for topic in topics for endpoint in there[topic]}
    participants |= {_participant(endpoint) for topic in peers for endpoint in node.get_publishers_info_by_topic(topic)}
    missing = [
        f"a subscriber of {publisher.topic_name}"
        for publisher, count in expected.items()
        if _readers(node, publisher, participants, options) < count + int(options.view)
    ]
    return missing + [f"a publisher of {topic}" for topic in topics if not there[topic]]


def pause_briefly(serve: Callable[[], None]) -> None:
    """Wait 10 ms and answer requests; messages stay in their queues. Raises `Stopped` after a signal."""
    clock.sleep(0.01)
    serve()
    check_wanted()


def _participant(end: TopicEndpointInfo) -> bytes:
    """DDS participant of a topic endpoint: the GUID prefix of its identity (RTPS 2.5, 8.2.4.1)."""
    return bytes(end.endpoint_gid)[:NODE]


def _readers(node: Node, publisher: Publisher[Any], participants: set[bytes], options: Options) -> int:
    """Number of a publisher's readers that are peers, plus one live view and one `ros2 bag` if these are awaited.

    A live view is recognised by best-effort QoS. The publisher's own count of matched readers is the upper limit.
    """
    readers = node.get_subscriptions_info_by_topic(publisher.topic_name)
    peers = sum(_participant(reader) in participants for reader in readers)
    views = any(reader.qos_profile.reliability == QoSReliabilityPolicy.BEST_EFFORT for reader in readers)
    bags = any(reader.node_name.startswith(BAG) for reader in readers)
    expected_listeners = int(options.view and views) + int(options.recorder and bags)
    return min(peers + expected_listeners, publisher.get_subscription_count())


def finish(publishers: Iterable[Publisher[Any]], timeout: float) -> None:
    """Wait at most `timeout` seconds in total until every reader has acknowledged all messages."""
    deadline = clock.monotonic() + timeout
    for publisher in publishers:
        left = max(0.0, deadline - clock.monotonic())
        publisher.wait_for_all_acked(rclpy.duration.Duration(seconds=left))
