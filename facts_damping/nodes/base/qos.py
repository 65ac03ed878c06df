"""Quality of service (QoS) that publishers offer and subscribers request."""

from __future__ import annotations

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

# Only the emulated link may lose data, so all topics are reliable and a subscriber keeps all messages not yet taken. A
# publisher keeps DEPTH messages for slow subscribers; one that stops reading for longer misses some and blocks no node.
DEPTH = 5000
SUBSCRIBER_QOS = QoSProfile(history=QoSHistoryPolicy.KEEP_ALL, reliability=QoSReliabilityPolicy.RELIABLE, depth=0)
PUBLISHER_QOS = QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, reliability=QoSReliabilityPolicy.RELIABLE, depth=DEPTH)


def listening(depth: int) -> QoSProfile:
    """Best effort: publishers do not wait for such a reader, so a slow one misses messages but delays no node."""
    best = QoSReliabilityPolicy.BEST_EFFORT
    return QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, reliability=best, depth=depth)


# For late subscribers, LATCHED keeps the newest message (state of the run), LOGGED up to 1000 (changes of the run).
LATCHED, LOGGED = (
    QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        reliability=QoSReliabilityPolicy.RELIABLE,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
        depth=depth,
    )
    for depth in (1, 1000)
)
LATCHED_SUBSCRIBER_QOS = QoSProfile(
    history=QoSHistoryPolicy.KEEP_ALL,
    reliability=QoSReliabilityPolicy.RELIABLE,
    durability=QoSDurabilityPolicy.TRANSIENT_LOCAL,
    depth=0,
)
