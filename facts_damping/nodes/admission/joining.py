"""Joining a running graph: a joining node stays disarmed, and its output has no effect, until an operator arms it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from facts_damping.nodes.transport.messages import Health
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from rclpy.node import Node

    from facts_damping.nodes.base.parameters import Options

NEVER = -1  # ns, time of an event that has not happened yet


class Joining:
    """Joined and armed state of a node."""

    def __init__(self, node: Node, options: Options, *, arms: bool = True) -> None:
        """If `arms`, offer the service `~/arm`; a joining node is then disarmed until it is called."""
        self.joins, self._began, self._asked = options.join and arms, False, False
        self._joined_ns = self._armed_ns = NEVER
        if arms:
            node.create_service(Trigger, "~/arm", self.on_arm)

    def on_arm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Arm the node from the next tick on."""
        response.success = self._joined_ns != NEVER and not self._asked
        response.message = "armed" if response.success else "it is armed" if self._began else "it has not begun yet"
        self._asked |= response.success
        return response

    def begin(self, start_ns: int) -> bool:
        """Begin a tick. Returns true if the node joins or becomes armed at this tick."""
        first, self._began = not self._began, True
        if first and self.joins and start_ns > 0:
            self._joined_ns = start_ns
            return True
        if self._asked and self._armed_ns == NEVER:
            self._armed_ns = start_ns
            return True
        return False

    @property
    def acts(self) -> bool:
        """Whether the node's output may take effect."""
        return self._joined_ns == NEVER or self._armed_ns != NEVER

    def health(self) -> Health | None:
        """When the node joined, and whether it is armed; None if it has been there from the beginning."""
        if self._joined_ns == NEVER:
            return None
        values, text = {"joined_ns": self._joined_ns}, f"joined at {self._joined_ns / NANOSECONDS:.3f} s"
        if self._armed_ns == NEVER:
            return Health(DiagnosticStatus.WARN, f"{text}, disarmed", values)
        values["armed_ns"] = self._armed_ns
        return Health(DiagnosticStatus.OK, f"{text}, armed at {self._armed_ns / NANOSECONDS:.3f} s", values)
