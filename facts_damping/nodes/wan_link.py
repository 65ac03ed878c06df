"""wan_link: delivers PMU data frames to the controllers and setpoints to the plant, late by the link's delays."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import LinkStatistics, PmuDataFrame, VoltageSetpoints

from facts_damping.errors import RunError
from facts_damping.link.transfer import downlink, uplink
from facts_damping.loop import rehearse, tick_ns
from facts_damping.nodes.messages import link_statistics
from facts_damping.nodes.node import RELIABLE, publish, run_node, wait_for_peers
from facts_damping.nodes.parameters import read_case, read_options
from facts_damping.nodes.spinning import Spinner
from facts_damping.nodes.tables import Frames, Setpoints
from facts_damping.parts import build_link, controller_names, identifier_names
from facts_damping.signals import CHANNELS, SETPOINT

if TYPE_CHECKING:
    from rclpy.node import Node


class WanLink:
    """Both directions of a link, and what has come in the tick that is going on."""

    def __init__(self, node: Node) -> None:
        """Read parameters, build the link, wire the topics."""
        self.case, self.options = read_case(node), read_options(node)
        self.up, self.down = build_link(self.case)
        self.frames, self.setpoints = Frames(self.case), Setpoints(self.case)
        self.names = controller_names(self.case)
        self.frame = np.full((len(self.case.system.stations), len(CHANNELS)), np.nan)
        self.to_controllers = node.create_publisher(PmuDataFrame, "pmu/delivered", RELIABLE)
        self.to_plant = node.create_publisher(VoltageSetpoints, "setpoints/delivered", RELIABLE)
        self.to_recorder = node.create_publisher(LinkStatistics, "link/statistics", RELIABLE)
        node.create_subscription(PmuDataFrame, "pmu/frames", self.on_frame, RELIABLE, raw=True)
        for name in self.names:
            node.create_subscription(VoltageSetpoints, f"{name}/setpoints", self.on_setpoints, RELIABLE, raw=True)
        self.tick, self.heard = -1, time.monotonic()
        self.missing: set[str] = set()
        self.given: dict[str, list[Any]] = {name: [] for name in self.names}
        rehearse(self.case)
        self.spinner = Spinner(node)
        extra = int(self.options.recorder)
        listeners = len(self.names) + len(identifier_names(self.case))
        wait_for_peers(
            node,
            {self.to_controllers: listeners + extra, self.to_plant: 1 + extra, self.to_recorder: extra},
            self.options,
        )

    def span(self, tick: int) -> tuple[int, int]:
        """Start and end of a tick, ns."""
        rate = self.case.run.frame_rate
        return tick_ns(tick, rate), tick_ns(tick + 1, rate)

    def on_frame(self, data: bytes) -> None:
        """A new tick: send its frame up, deliver what arrives in it."""
        if self.missing:
            self.answer()  # real time: the plant did not wait for a controller that is late
        self.tick, rows = self.frames.read(data)
        start, end = self.span(self.tick)
        self.frame[rows["station"]] = rows["values"]
        count = uplink(self.up, self.tick, start, end, self.frame)
        publish(self.to_controllers, self.frames.fill(self.tick, start, self.up.out, count))
        self.missing = set(self.names)
        if not self.missing:
            self.answer()

    def on_setpoints(self, data: bytes) -> None:
        """A controller's setpoints; the last one's bring the answer to the plant."""
        tick, controller, rows = self.setpoints.read(data)
        if controller not in self.given:
            return
        self.given[controller].append(rows)
        if tick == self.tick and self.missing:
            self.missing.discard(controller)
            if not self.missing:
                self.answer()

    def answer(self) -> None:
        """Send the setpoints down, in the order of the controllers, and deliver what arrives in the tick."""
        start, end = self.span(self.tick)
        rows = [row for name in self.names for row in self.given[name]]
        given = np.concatenate(rows) if rows else np.zeros(0, SETPOINT)
        for kept in self.given.values():
            kept.clear()
        count = downlink(self.down, self.tick, end, given, len(given))
        publish(self.to_plant, self.setpoints.fill(self.tick, start, self.down.out[:count], ""))
        self.missing = set()
        if (self.tick + 1) % self.case.run.frame_rate == 0:
            self.tell()

    def tell(self) -> None:
        """Publish the statistics."""
        up = dict(zip([s.name for s in self.case.system.stations], self.up.statistics, strict=True))
        down = dict(zip(self.case.run.devices, self.down.statistics, strict=False))
        publish(self.to_recorder, link_statistics(self.tick, self.span(self.tick)[0], up, down))

    def run(self) -> None:
        """Serve until stopped; in lockstep, name who stays silent."""
        while True:
            if self.spinner.turn(0.1):
                self.heard = time.monotonic()
            elif self.owed() and time.monotonic() - self.heard > self.options.timeout:
                who = ", ".join(sorted(self.missing)) or "plant_sim"
                raise RunError(f"{who} is silent: nothing after tick {self.tick} within {self.options.timeout:g} s")

    def owed(self) -> bool:
        """Whether, in lockstep, a controller owes its setpoints or the plant its next frame."""
        if self.options.realtime or self.tick < 0:
            return False
        return bool(self.missing) or self.tick + 1 < self.case.ticks


def main() -> None:
    """Entry point of `ros2 run facts_damping wan_link`."""
    run_node("wan_link", WanLink)


if __name__ == "__main__":
    main()
