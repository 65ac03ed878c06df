"""plant_sim: publishes PMU data frames and the truth, subscribes to setpoints, advances the plant."""

from __future__ import annotations

import sys
import time
from functools import partial
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from facts_damping_msgs.msg import DeviceSetpoints, GridEvent, PlantState, PmuDataFrame, RunState

from facts_damping.case.names import link_addresses, served, supervisor_names
from facts_damping.errors import RunError
from facts_damping.nodes.admission.member import PLANT, Member
from facts_damping.nodes.base.clock import SimulatedClock
from facts_damping.nodes.base.discovery import finish
from facts_damping.nodes.base.live_parameters import MeasurementParameters
from facts_damping.nodes.base.parameters import read_case, read_options, read_stamp
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import Stopped, check_wanted
from facts_damping.nodes.live_plant import LivePlant
from facts_damping.nodes.run_control import RunControl
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.messages import (
    Health,
    PlantStateMessage,
    grid_event,
    run_done,
    run_stopped,
    synchronism_lost,
)
from facts_damping.nodes.transport.signing import seal, signing
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode

PROGRESS_S = 0.2  # wall time between two progress lines


class PlantSim:
    """Node of the plant: publishers, and the setpoints received."""

    def __init__(self, node: ManagedNode) -> None:
        """Read parameters, build the plant, set up the topics."""
        self.case, self.options = read_case(node), read_options(node, joins=False)
        self.stamp = read_stamp(node, self.options)
        self.plant = LivePlant(self.case)
        by = signing(self.case, self.options.start_timeout)
        self.frames, self.truth = FramesMessage(self.case, seal(by, "pmu/frames")), PlantStateMessage(self.case)
        self.to_links = node.create_publisher(PmuDataFrame, "pmu/frames", PUBLISHER_QOS)
        self.to_all = node.create_publisher(PlantState, "plant/state", PUBLISHER_QOS)
        self.to_events = node.create_publisher(GridEvent, "plant/events", PUBLISHER_QOS)
        self.clock = SimulatedClock(node)
        self.member = Member(node, self.case, self.options, PLANT, hardware=self.case.system.name)
        self.control = RunControl(node, self.member, self.plant, self.progress)
        self.measurement = MeasurementParameters(node, self.case.measurement, self.change_measurement)
        self.links = link_addresses(self.case)
        for i, link in enumerate(self.links):
            topic = link.topic("setpoints/delivered")
            setpoints = SetpointsMessage(self.case, of=served(self.case, i), seal=seal(by, topic))
            use = partial(self.on_setpoints, i)
            self.member.message_filter.subscribe(DeviceSetpoints, topic, use, setpoints.read, lambda: self.plant.tick)
        self.answered = [-1 for _ in self.links]
        self.waiting: list[list[Any]] = [[] for _ in self.links]
        self.misses = self.misses_reported = 0
        self.released: list[str] = []
        endless = self.options.free and self.case.run.duration is None
        self.ticks = sys.maxsize if endless else self.case.ticks
        self.spinner, self.activation = self.member.spin(), self.control

    def ready(self) -> None:
        """Wait for the links, supervisors, and the recorder."""
        extra = int(self.options.recorder)
        for_recorder = [self.to_all, self.to_events, self.control.publisher]
        guarded = {self.to_all: len(supervisor_names(self.case)) + extra}
        expected = {self.to_links: len(self.links) + extra, **dict.fromkeys(for_recorder, extra), **guarded}
        self.member.wait(expected, self.spinner)

    def on_setpoints(self, link: int, tick: int, rows: NDArray[Any]) -> None:
        """Keep the setpoints that a link delivers in a tick until the plant advances."""
        self.answered[link] = tick
        self.waiting[link].append(rows)

    def publish(self, tick: int) -> None:
        """Publish the measurements, truth, clock and events of a tick; the frame first, since others wait for it."""
        plant, start_ns = self.plant, self.plant.start(tick)
        entries = plant.entries()
        self.to_links.publish(self.frames.fill(tick, start_ns, entries, len(entries)))
        self.to_all.publish(self.truth.fill(tick, start_ns, plant.sound, plant.machines, plant.devices))
        self.clock.publish(start_ns)
        for event in plant.due():
            self.to_events.publish(grid_event(event))

    def change_measurement(self, name: str, value: float) -> None:
        """Queue a new value of a measurement's number for the next tick."""
        self.member.change("parameter", name, value, self.plant.change_measurement(name, value))

    def health(self) -> Health:
        """Deadline misses, released devices, and loss of synchronism."""
        if not self.plant.sound:
            lost = synchronism_lost(self.plant.start(self.plant.tick))
            return Health(DiagnosticStatus.ERROR, lost, {"mode": self.options.mode})
        late, self.misses_reported = self.misses - self.misses_reported, self.misses
        released = self.plant.released()
        flaws = [f"{late} deadline misses in the last second"] if late else []
        flaws += [f"released: {', '.join(released)}"] if released else []
        level = DiagnosticStatus.WARN if flaws else DiagnosticStatus.OK
        values = {"deadline_misses": self.misses, "mode": self.options.mode, "released": ", ".join(released)}
        return Health(level, "; ".join(flaws) or "on time", values)

    def log_released(self) -> None:
        """Log devices that were released or take setpoints again."""
        now = self.plant.released()
        if now == self.released:
            return
        watchdog, log, at = (
            self.case.run.watchdog,
            self.member.message_filter.log,
            self.plant.start(self.plant.tick) / NANOSECONDS,
        )
        for device in set(now) - set(self.released):
            silent = f"no setpoint accepted for {watchdog.timeout:g} s" if watchdog else "reported_s so"
            again = f" or {watchdog.good} good setpoints" if watchdog and watchdog.good else ""
            log.warning(f"{device} released at {at:.3f} s: {silent}; re-armed by ~/rearm{again}")
        for device in set(self.released) - set(now):
            log.info(f"{device} takes setpoints again from {at:.3f} s on")
        self.released = now

    def progress(self) -> None:
        """Write the progress line `tick K N MISSES` for the program that runs the graph."""
        self.member.message_filter.log.line(f"tick {self.plant.tick + 1} {self.ticks} {self.misses}")

    def wait_lockstep(self, tick: int) -> None:
        """Wait for the setpoints of a tick. Raises `RunError` naming silent links."""
        # A link waits less long for a silent controller, so it gives up first and names the controller.
        patience = self.options.patience(tick)
        deadline = time.monotonic() + patience + 1.0
        while min(self.answered) < tick:
            if not self.spinner.spin_once(0.05) and time.monotonic() > deadline:
                who = ", ".join(str(self.links[i]) for i, newest in enumerate(self.answered) if newest < tick)
                raise RunError(f"{who} is silent: no setpoints of tick {tick} within {patience:g} s")

    def wait_paced(self, tick: int, wall_end: float) -> None:
        """Take messages until the end of the tick in wall time; count a deadline miss if setpoints have not come.

        In a free graph, only links that have answered within the last second count.
        """
        while (left := wall_end - time.monotonic()) > 0:
            self.spinner.spin_once(left)
        self.spinner.take_all()
        oldest = max(0, tick - self.case.run.frame_rate) if self.options.free else 0
        self.misses += any(oldest <= newest < tick for newest in self.answered)

    def run(self) -> None:
        """Run to the end or until stopped; publish which of both as the run's state."""
        try:
            self.simulate()
        except Stopped:
            tick = self.plant.tick
            self.control.publish_state(RunState.ENDED, tick, run_stopped(tick, self.ticks, self.case.run.frame_rate))
            raise

    def simulate(self) -> None:
        """Simulate all ticks or until synchronism is lost; without end in a free graph without a duration."""
        plant, wall_start, reported_s = self.plant, time.monotonic(), -PROGRESS_S
        for k in range(self.ticks):
            check_wanted()
            if held := self.control.hold(k, self.spinner):
                wall_start += held
                plant.excuse(held)
            if k == 0:
                stamps.begin(time.time_ns() if self.stamp == "wall" else 0)
                self.control.publish_state(RunState.RUNNING, 0, "begins")
            self.member.begin(k)
            plant.measure(k)
            self.publish(k)
            self.member.report_health(self.health, last=not plant.sound)
            if not self.options.paced or (k == 0 and not self.options.free):
                self.wait_lockstep(k)
            if k == 0:
                wall_start = time.monotonic()  # pacing starts when all nodes have answered once
            if self.options.paced:
                self.wait_paced(k, wall_start + plant.start(k + 1) * 1e-9)
            if time.monotonic() - reported_s > PROGRESS_S or k + 1 == self.ticks or not plant.sound:
                reported_s = time.monotonic()
                self.progress()
            if not plant.sound:
                break
            plant.advance([rows for kept in self.waiting for rows in kept])
            for kept in self.waiting:
                kept.clear()
            self.log_released()
            for device, release in plant.late() if self.options.paced else ():
                self.member.change("release", device, act=release)
        self.end(k, plant.sound)

    def end(self, tick: int, sound: bool) -> None:
        """Publish and log that the run has ended, and why."""
        log, start = self.member.message_filter.log, self.plant.start(tick)
        text = run_done(tick, self.case.run.frame_rate) if sound else synchronism_lost(start)
        self.control.publish_state(RunState.ENDED, tick, text, sound)
        if sound:
            log.info(text)
        else:
            log.error(text)
        finish([self.to_links, self.to_all, self.to_events, self.control.publisher], self.options.timeout)


def main() -> None:
    """Entry point of `ros2 run facts_damping plant_sim`."""
    run_node("plant_sim", PlantSim, "The power system: publishes PMU frames, takes setpoints; alone it runs free.")


if __name__ == "__main__":
    main()
