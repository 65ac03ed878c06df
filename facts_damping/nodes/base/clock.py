"""`/clock`: the simulated time, for nodes with `use_sim_time`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from facts_damping.nodes.transport.messages import set_time

if TYPE_CHECKING:
    from rclpy.node import Node

LAST = QoSProfile(depth=1)  # reliable; a slow subscriber gets only the newest time


class SimulatedClock:
    """Publishes the start of each tick."""

    def __init__(self, node: Node) -> None:
        """Make the publisher; `/clock` is global, whatever the node's namespace."""
        self._publisher, self._message = node.create_publisher(Clock, "/clock", LAST), Clock()

    def publish(self, start_ns: int) -> None:
        """Publish the time of a tick; `start_ns`: its simulated start."""
        set_time(self._message.clock, start_ns)  # with `stamp: wall` this is wall time
        self._publisher.publish(self._message)
