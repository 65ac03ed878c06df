"""`/clock`: the simulated time, for nodes with `use_sim_time`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from facts_damping.nodes.transport.messages import set_time

if TYPE_CHECKING:
    from rclpy.node import Node

LAST = QoSProfile(depth=1)  # reliable; who is late misses all but the last


class SimulatedClock:
    """Publishes the start of each tick."""

    def __init__(self, node: Node) -> None:
        """Make the publisher; `/clock` is everybody's, whatever the namespace."""
        self._publisher, self._message = node.create_publisher(Clock, "/clock", LAST), Clock()

    def tell(self, start_ns: int) -> None:
        """Tell a time, ns."""
        set_time(self._message.clock, start_ns)  # of what is stamped by the wall clock, that
        self._publisher.publish(self._message)
