"""plant_sim: publishes PMU data frames and the truth, subscribes to setpoints, advances the plant."""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from facts_damping_msgs.msg import GridEvent, PlantState, PmuDataFrame, VoltageSetpoints
from std_srvs.srv import Trigger

from facts_damping.case.names import link_addresses, served
from facts_damping.compiling import specialised
from facts_damping.errors import RunError
from facts_damping.link.transfer import merge
from facts_damping.nodes.guard import Guard
from facts_damping.nodes.messages import PlantStateMessage, diagnostics, grid_event, synchronism_lost
from facts_damping.nodes.node import SAYING, finish, run_node
from facts_damping.nodes.parameters import read_case, read_options
from facts_damping.nodes.signing import seal, signing
from facts_damping.nodes.spinning import Spinner, check_wanted
from facts_damping.nodes.tables import FramesMessage, SetpointsMessage
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import workspace
from facts_damping.plant.watchdog import listening, rearm, release_by_clock
from facts_damping.signals import CHANNELS, DELIVERY, DEVICE_TRUTH, MACHINE_TRUTH, SETPOINT
from facts_damping.simulation.build import build_plant, grid_events
from facts_damping.simulation.loop import tick_ns

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.node import Node

PROGRESS_S = 0.2  # wall time between two lines of progress on standard output


class PlantSim:
    """One plant: state, publishers, and the setpoints that have come."""

    def __init__(self, node: Node) -> None:
        """Read parameters, build the plant, wire the topics."""
        self.case, self.options = read_case(node), read_options(node, joins=False)
        built = build_plant(self.case)
        self.plant, self.state = built.plant, built.state
        self.work = workspace(self.plant, self.state)
        stations = len(self.case.system.stations)
        self.frame = np.zeros((stations, len(CHANNELS)))
        self.entries = np.zeros(stations, DELIVERY)
        self.entries["station"] = np.arange(stations)
        self.machines = np.zeros(len(self.plant.machines), MACHINE_TRUTH)
        self.devices = np.zeros(len(self.plant.devices), DEVICE_TRUTH)
        by = signing(self.case, self.options.start_timeout)
        self.frames, self.truth = FramesMessage(self.case, seal(by, "pmu/frames")), PlantStateMessage(self.case)
        self.to_links = node.create_publisher(PmuDataFrame, "pmu/frames", SAYING)
        self.to_all = node.create_publisher(PlantState, "plant/state", SAYING)
        self.to_events = node.create_publisher(GridEvent, "plant/events", SAYING)
        self.to_diagnostics = node.create_publisher(DiagnosticArray, "/diagnostics", SAYING)
        self.to_recorder = [self.to_all, self.to_events, self.to_diagnostics]
        node.create_service(Trigger, "~/rearm", self.on_rearm)
        self.links, self.tick = link_addresses(self.case), -1
        self.guard = Guard(node, self.case, self.options)
        for i, link in enumerate(self.links):
            topic = link.topic("setpoints/delivered")
            setpoints = SetpointsMessage(self.case, of=served(self.case, i), seal=seal(by, topic))
            use = partial(self.on_setpoints, i)
            self.guard.subscribe(VoltageSetpoints, topic, use, setpoints.read, lambda: self.tick)
        self.answered = [-1 for _ in self.links]
        self.waiting: list[list[Any]] = [[] for _ in self.links]
        self.heard = listening(len(self.devices))
        self.now_ns = 0
        self.events = grid_events(self.case)
        self.misses = 0
        table = np.zeros(0, SETPOINT)
        self.observe = specialised(
            measure, self.plant, self.state, 0, self.frame, self.machines, self.devices, self.work
        )
        self.merge = specialised(merge, table, 0, table, 0)
        self.step = specialised(advance, self.plant, self.state, 0, 0, table, 0, self.work)
        self.spinner = Spinner(node, self.guard)
        extra = int(self.options.recorder)
        self.guard.wait_for_peers({self.to_links: len(self.links) + extra, **dict.fromkeys(self.to_recorder, extra)})

    def on_setpoints(self, link: int, tick: int, rows: NDArray[Any]) -> None:
        """Keep the setpoints that a link delivers in a tick until the plant advances."""
        self.answered[link] = tick
        self.waiting[link].append(rows)

    def measure(self, tick: int, start_ns: int) -> bool:
        """Measure at the start of a tick and publish: the frame first, since others wait for it."""
        self.tick = tick
        measured = self.plant, self.state, start_ns, self.frame, self.machines, self.devices, self.work
        sound = bool(self.observe(*measured))
        self.entries["measured_ns"] = self.entries["arrival_ns"] = start_ns
        self.entries["values"] = self.frame
        self.to_links.publish(self.frames.fill(tick, start_ns, self.entries, len(self.entries)))
        self.to_all.publish(self.truth.fill(tick, start_ns, sound, self.machines, self.devices))
        while self.events and self.events[0]["time_ns"] <= start_ns:
            self.to_events.publish(grid_event(self.events.pop(0)))
        return sound

    def advance(self, start_ns: int, end_ns: int) -> None:
        """Advance to the next tick under the setpoints that have come, whichever link's came first."""
        come = [rows for kept in self.waiting for rows in kept]
        table, count = np.zeros(sum(map(len, come)), SETPOINT), 0
        for rows in come:
            count = self.merge(table, count, rows, len(rows))
        for kept in self.waiting:
            kept.clear()
        self.step(self.plant, self.state, start_ns, end_ns, table, count, self.work)

    def on_rearm(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Let every released device take setpoints again."""
        released = [name for d, name in enumerate(self.case.run.devices) if self.state.watch["released"][d]]
        rearm(self.state.watch, self.now_ns)
        response.success = bool(released)
        response.message = f"re-armed: {', '.join(released)}" if released else "no device is released"
        return response

    def wait_lockstep(self, tick: int) -> None:
        """Wait for the setpoints of a tick; a link that stays silent is named."""
        # A link gives up on a silent controller first, and names it: its patience is shorter.
        patience = self.options.patience(tick)
        deadline = time.monotonic() + patience + 1.0
        while min(self.answered) < tick:
            if not self.spinner.spin_once(0.05) and time.monotonic() > deadline:
                who = ", ".join(str(self.links[i]) for i, newest in enumerate(self.answered) if newest < tick)
                raise RunError(f"{who} is silent: no setpoints of tick {tick} within {patience:g} s")

    def wait_realtime(self, tick: int, wall_end: float) -> None:
        """Take what comes until the clock says that the tick is over; count it if its setpoints are not there."""
        while (left := wall_end - time.monotonic()) > 0:
            self.spinner.spin_once(left)
        self.spinner.take_all()
        self.misses += min(self.answered) < tick

    def run(self) -> None:
        """All ticks, or until the plant is no longer sound; progress as lines `tick K N MISSES` on standard output."""
        rate, ticks = self.case.run.frame_rate, self.case.ticks
        wall_start, told = time.monotonic(), -PROGRESS_S
        for k in range(ticks):
            check_wanted()
            start, end = tick_ns(k, rate), tick_ns(k + 1, rate)
            sound = self.measure(k, start)
            if k % rate == 0 or not sound:
                self.to_diagnostics.publish(diagnostics("plant_sim", self.options.mode, self.misses, start, sound))
            if not self.options.realtime or k == 0:
                self.wait_lockstep(k)
            if k == 0:
                wall_start = time.monotonic()  # the clock starts when all have answered once
            if self.options.realtime:
                self.wait_realtime(k, wall_start + end * 1e-9)
            if time.monotonic() - told > PROGRESS_S or k + 1 == ticks or not sound:
                told = time.monotonic()
                sys.stdout.write(f"tick {k + 1} {ticks} {self.misses}\n")
                sys.stdout.flush()
            if not sound:
                sys.stdout.write(f"{synchronism_lost(start)}\n")
                break
            self.advance(start, end)
            self.now_ns = end
            if self.options.realtime and self.case.run.watchdog is not None:
                release_by_clock(self.state.watch, self.heard, time.monotonic(), self.case.run.watchdog.timeout)
        finish([self.to_links, self.to_all, self.to_events], self.options.timeout)


def main() -> None:
    """Entry point of `ros2 run facts_damping plant_sim`."""
    run_node("plant_sim", PlantSim)


if __name__ == "__main__":
    main()
