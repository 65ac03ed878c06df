"""A controller as a user would write it, for storms: a plain rclpy node that answers each tick with one setpoint."""

from __future__ import annotations

import time
from contextlib import suppress

import rclpy
from facts_damping_msgs.msg import DeviceSetpoint, DeviceSetpoints, PmuDataFrame
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

LISTENERS = 2  # the link, or its supervisor, and the recorder


class OwnController(Node):
    """Answers the frames of each tick; its setpoint changes its sign from tick to tick."""

    def __init__(self) -> None:
        super().__init__("controller")
        self._device: str = self.declare_parameter("device", "sssc").value
        self._publisher = self.create_publisher(DeviceSetpoints, "~/setpoints", 5000)
        self.create_subscription(PmuDataFrame, "pmu/delivered", self._answer, 5000)

    def _answer(self, message: PmuDataFrame) -> None:
        while message.tick == 0 and self._publisher.get_subscription_count() < LISTENERS:
            time.sleep(0.01)
        reply = DeviceSetpoints(header=message.header, tick=message.tick, controller=self.get_name())
        for frame in message.frames[-1:]:
            setpoint = DeviceSetpoint(device=self._device, controller=self.get_name())
            setpoint.header.stamp, setpoint.issued, setpoint.effective = (
                frame.header.stamp,
                frame.arrival,
                frame.arrival,
            )
            setpoint.value_pu, reply.fresh = 0.01 * (-1.0) ** message.tick, True
            reply.setpoints.append(setpoint)
        self._publisher.publish(reply)


def main() -> None:
    """Run the node."""
    with rclpy.init(), suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(OwnController())
