"""Joining a graph in real time that is under way: what such a node does acts on nothing until an operator arms it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger

from facts_damping.nodes.messages import joined
from facts_damping.nodes.node import COMMON, SAYING
from facts_damping.simulation.loop import tick_ns

if TYPE_CHECKING:
    from rclpy.node import Node

    from facts_damping.nodes.parameters import Options

NEVER = -1  # ns, of what has not happened yet


class Joining:
    """Whether a node has joined, and whether what it does may act; it says so once a simulated second."""

    def __init__(self, node: Node, options: Options, frame_rate: int) -> None:
        """Offer the service that arms, and make room for what is said; neither where the node may not join."""
        self._name, self._rate = node.get_fully_qualified_name(), frame_rate
        self._began = self._asked = False
        self._joined_ns = self._armed_ns = NEVER
        if options.join:
            node.create_service(Trigger, "~/arm", self.on_arm)
            self._publisher = node.create_publisher(DiagnosticArray, COMMON, SAYING)

    def on_arm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Arm the node, from the next tick on."""
        response.success = self._joined_ns != NEVER and not self._asked
        response.message = "armed" if response.success else "it is armed" if self._began else "it has not begun yet"
        self._asked |= response.success
        return response

    def acts(self, tick: int) -> bool:
        """Whether what the node does in a tick may act. To be asked in every tick."""
        began, self._began = self._began, True
        if not began and tick > 0:
            self._joined_ns = tick_ns(tick, self._rate)
        if self._joined_ns == NEVER:
            return True
        new = not began
        if self._asked and self._armed_ns == NEVER:
            self._armed_ns, new = tick_ns(tick, self._rate), True
        if new or tick % self._rate == 0:
            message = joined(self._name, self._joined_ns, self._armed_ns, tick_ns(tick, self._rate))
            self._publisher.publish(message)
            if new:
                sys.stdout.write(f"{message.status[0].message}\n")
                sys.stdout.flush()
        return self._armed_ns != NEVER
