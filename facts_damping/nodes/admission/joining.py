"""Joining a graph under way: what such a node does acts on nothing until an operator arms it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from facts_damping.nodes.transport.messages import Health
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from rclpy.node import Node

    from facts_damping.nodes.base.parameters import Options

NEVER = -1  # ns, of what has not happened yet


class Joining:
    """Whether a node has joined, and whether what it does may act."""

    def __init__(self, node: Node, options: Options, *, arms: bool = True) -> None:
        """Offer the service that arms; `arms`: by it one that joins is let act, until then it is disarmed."""
        self.joins, self._began, self._asked = options.join and arms, False, False
        self._joined_ns = self._armed_ns = NEVER
        if arms:
            node.create_service(Trigger, "~/arm", self.on_arm)

    def on_arm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Arm the node, from the next tick on."""
        response.success = self._joined_ns != NEVER and not self._asked
        response.message = "armed" if response.success else "it is armed" if self._began else "it has not begun yet"
        self._asked |= response.success
        return response

    def begin(self, start_ns: int) -> bool:
        """Begin a tick; whether something has changed: the node has joined, or is armed from here on."""
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
        """Whether what the node does may act."""
        return self._joined_ns == NEVER or self._armed_ns != NEVER

    def health(self) -> Health | None:
        """When the node has joined, and whether it is armed; None where it has been there from the beginning."""
        if self._joined_ns == NEVER:
            return None
        values, text = {"joined_ns": self._joined_ns}, f"joined at {self._joined_ns / NANOSECONDS:.3f} s"
        if self._armed_ns == NEVER:
            return Health(DiagnosticStatus.WARN, f"{text}, disarmed", values)
        values["armed_ns"] = self._armed_ns
        return Health(DiagnosticStatus.OK, f"{text}, armed at {self._armed_ns / NANOSECONDS:.3f} s", values)
