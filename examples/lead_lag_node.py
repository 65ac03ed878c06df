"""The lead-lag LLC as a node of one's own (docs/extensions.md): facts-damping run examples/lead_lag_node.yaml."""

import time
from contextlib import suppress
from itertools import groupby

import rclpy
from facts_damping_msgs.msg import DeviceSetpoint, DeviceSetpoints, PmuDataFrame
from lead_lag import LeadLag
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

WEIGHTS = {"G1": 2.0, "G2": -1.0, "G4": -1.0}  # of the signal `speed` of two_area, in the order of its PMUs
DEVICE, LIMIT = "sssc", 0.1  # p.u.


def ns(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


class Controller(Node):
    def __init__(self):
        super().__init__("controller")
        self.parameters = {"gain": self.declare_parameter("gain", 10.0).value}
        self.publisher = self.create_publisher(DeviceSetpoints, "~/setpoints", 5000)
        self.create_subscription(PmuDataFrame, "pmu/delivered", self.answer, 5000)

    def answer(self, message):  # each tick, with one message; it acts where a frame is newer than all before
        if message.tick == 0:
            self.law, self.held, self.newest_ns = LeadLag(self), {}, -1
            while self.publisher.get_subscription_count() < 2:  # the link, and the recorder of `facts-damping run`
                time.sleep(0.01)
        reply = DeviceSetpoints(header=message.header, tick=message.tick, controller=self.get_name())
        for arrival, frames in groupby(message.frames, key=lambda frame: frame.arrival):
            for f in (one for one in frames if one.pmu in WEIGHTS):
                self.held[f.pmu] = max(self.held.get(f.pmu, f), f, key=lambda one: ns(one.header.stamp))
            newest = max((f.header.stamp for f in self.held.values()), key=ns, default=None)
            if len(self.held) == len(WEIGHTS) and ns(newest) > self.newest_ns:
                self.newest_ns, t_ns = ns(newest), ns(arrival)
                y = sum(weight * self.held[pmu].speed_deviation_pu for pmu, weight in WEIGHTS.items())
                u = self.law.step(t_ns / 1e9, [y], [(t_ns - self.newest_ns) * 1e-9], [True])
                one = DeviceSetpoint(device=DEVICE, controller=reply.controller, issued=arrival, effective=arrival)
                one.header.stamp, one.value_pu, reply.fresh = newest, min(max(u, -LIMIT), LIMIT), True
                reply.setpoints.append(one)
        self.publisher.publish(reply)


def main():
    with rclpy.init(), suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(Controller())


if __name__ == "__main__":
    main()
