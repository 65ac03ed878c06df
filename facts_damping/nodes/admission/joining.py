"""Arming: whether what a node does has an effect. A joining node is inactive, disarmed, until an operator arms it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticStatus
from std_srvs.srv import Trigger

from facts_damping.errors import InputError
from facts_damping.nodes.transport.messages import Health
from facts_damping.signals import NANOSECONDS, NOT_YET

if TYPE_CHECKING:
    from rclpy.lifecycle import LifecycleNode

    from facts_damping.nodes.base.parameters import Options


class Joining:
    """Joined and armed state of a node: armed where its lifecycle state is `active`."""

    def __init__(self, node: LifecycleNode, options: Options, *, arms: bool = True) -> None:
        """If `arms`, offer the service `~/arm`; a joining node is then disarmed until it is called."""
        self._node, self._lockstep = node, not options.paced
        self.waits, self.takes_part = options.join and arms, options.paced
        self._began, self._wanted = False, not arms
        self.acts = not arms  # whether the node's output has an effect
        self._joined_ns = self._armed_ns = NOT_YET
        if arms:
            node.create_service(Trigger, "~/arm", self.on_arm)

    def on_arm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Arm the node from the next tick on: the same as `activate`."""
        response.success = self._began and not self._wanted
        response.message = "it acts already" if self._began else "it has not begun yet"
        if response.success:
            response.message = "it acts from the next tick on"
            self._node.trigger_activate()
        return response

    def activate(self) -> None:
        """Arm the node from the next tick on."""
        self._wanted = True

    def deactivate(self) -> None:
        """Disarm the node from the next tick on. Raises `InputError` in lockstep."""
        if self._lockstep:
            raise InputError("deactivate given in mode lockstep; allowed: in realtime and free")
        self._wanted = False

    def begin(self, start_ns: int) -> str:
        """Begin a tick. Returns what changes with it: `join`, `arm`, `disarm` or nothing."""
        first, self._began = not self._began, True
        if first and self.waits and start_ns == 0 and not self._wanted:
            self._node.trigger_activate()  # it begins with the run: there is nothing to join
        before, self.acts = self.acts, self._wanted
        if first:
            self._joined_ns = start_ns if self.waits and start_ns > 0 else NOT_YET
            return "join" if self._joined_ns != NOT_YET else "" if self.acts else "disarm"
        if self.acts == before:
            return ""
        self._armed_ns = start_ns if self.acts else NOT_YET
        return "arm" if self.acts else "disarm"

    def health(self) -> Health | None:
        """When the node joined, and whether it is armed; None if it has been there, armed, from the beginning."""
        joined = self._joined_ns != NOT_YET
        if not joined:
            return None if self.acts else Health(DiagnosticStatus.WARN, "inactive", {})
        values, text = {"joined_ns": self._joined_ns}, f"joined at {self._joined_ns / NANOSECONDS:.3f} s"
        if not self.acts:
            return Health(DiagnosticStatus.WARN, f"{text}, disarmed", values)
        values["armed_ns"] = self._armed_ns
        return Health(DiagnosticStatus.OK, f"{text}, armed at {self._armed_ns / NANOSECONDS:.3f} s", values)
