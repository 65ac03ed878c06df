"""plant_sim: publishes PMU data frames and the truth, subscribes to setpoints, advances the plant."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from facts_damping_msgs.msg import RunState

from facts_damping.nodes import clock
from facts_damping.nodes.base.live_parameters import MeasurementParameters
from facts_damping.nodes.base.parameters import read_case, read_options, read_stamp
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import check_wanted
from facts_damping.nodes.frame_source import FrameSource, SimulatedClock
from facts_damping.nodes.live_plant import LivePlant
from facts_damping.nodes.run_control import RunControl
from facts_damping.nodes.transport import stamps
from facts_damping.nodes.transport.messages import Health, grid_event, synchronism_lost
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode

DRAWS = 36_000  # frames after which measurement noise repeats in an endless graph: ten minutes at 60 frames/s


class PlantSim:
    """Node of the plant: publishers, and the setpoints received."""

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options = read_case(node), read_options(node, joins=False)
        self.stamp = read_stamp(node, self.options)
        self.plant = LivePlant(self.case, DRAWS if self.options.free else 0)
        self.source = FrameSource(node, self.case, self.options, self.case.system.name)
        self.clock, self.member = SimulatedClock(node), self.source.member
        self.control = RunControl(node, self.source, self.plant, self.progress)
        self.measurement = MeasurementParameters(node, self.case.measurement, self.change_measurement)
        self.source.subscribe_links(self.on_setpoints, lambda: self.plant.tick)
        self.waiting: dict[str, list[NDArray[Any]]] = {link: [] for link in self.source.answered}
        self.misses = self.misses_reported = 0
        self.released: list[str] = []
        self.spinner, self.activation = self.member.spin(), self.control

    def ready(self) -> None:
        """Wait for the links, supervisors, and the recorder."""
        self.source.wait(self.spinner, len(self.source.answered))

    def on_setpoints(self, link: str, tick: int, rows: NDArray[Any]) -> None:
        """Keep the setpoints that a link delivers in a tick until the plant advances."""
        self.source.answered[link] = tick
        self.waiting[link].append(rows)

    def publish(self, tick: int) -> None:
        """Publish the measurements, truth, clock and events of a tick."""
        self.source.publish(tick, self.plant.entries(), self.plant.sound, self.plant.machines, self.plant.devices)
        self.clock.publish(self.plant.start(tick))
        for event in self.plant.due():
            self.source.to_events.publish(grid_event(event))

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
        if (now := self.plant.released()) == self.released:
            return
        watchdog, log = self.case.run.watchdog, self.member.message_filter.log
        at = self.plant.start(self.plant.tick) / NANOSECONDS
        for device in set(now) - set(self.released):
            silent = f"no setpoint accepted for {watchdog.timeout:g} s" if watchdog else "on command"
            again = f" or {watchdog.good} good setpoints" if watchdog and watchdog.good else ""
            log.warning(f"{device} released at {at:.3f} s: {silent}; re-armed by ~/rearm{again}")
        for device in set(self.released) - set(now):
            log.info(f"{device} re-armed at {at:.3f} s")
        self.released = now

    def progress(self, now: bool = True) -> None:
        """Write a progress line, if not `now` only when it is due."""
        self.source.progress(self.plant.tick + 1, self.misses, now)

    def awaited(self, tick: int) -> bool:
        """Whether setpoints of a tick have not come; in a free graph, of links that answered within the last second."""
        oldest = max(0, tick - self.case.run.frame_rate) if self.options.free else 0
        return any(oldest <= newest < tick for newest in self.source.answered.values())

    def take_until(self, wall: float, tick: int | None = None) -> None:
        """Take messages until a wall time, if a tick is given only until its setpoints have come."""
        while (left := wall - clock.monotonic()) > 0 and (tick is None or self.awaited(tick)):
            self.spinner.spin_once(left)
        self.spinner.take_all()

    def run(self) -> None:
        """Run to the end, until stopped, or until a node is silent; publish which of these as the run's state."""
        with self.source.until_end(lambda: self.plant.tick):
            self.simulate()

    def simulate(self) -> None:
        """Simulate all ticks or until synchronism is lost; without end in a free graph without a duration."""
        plant, wall_start = self.plant, clock.monotonic()
        for k in range(self.source.ticks):
            check_wanted()
            if held := self.control.hold(k, self.spinner):
                wall_start += held
                plant.excuse(held)
            if k == 0:
                stamps.begin(clock.time_ns() if self.stamp == "wall" else 0)
                self.source.publish_state(RunState.RUNNING, 0, "begins")
            elif self.options.paced:
                self.take_until(wall_start + plant.start(k) * 1e-9)
            self.member.begin(k)
            plant.measure(k)
            self.publish(k)
            self.member.report_health(self.health, last=not plant.sound)
            if not self.options.paced or (k == 0 and not self.options.free):
                self.source.wait_for_answers(self.spinner, k, "no setpoints of")
            if k == 0:
                wall_start = clock.monotonic()  # pacing starts when all nodes have answered once
            if self.options.paced:  # the plant advances early, so that a late answer does not make the next frames late
                self.take_until(wall_start + plant.start(k + 1) * 1e-9, None if self.options.free else k)
                self.misses += self.awaited(k)
            self.progress(now=k + 1 == self.source.ticks or not plant.sound)
            if not plant.sound:
                break
            waiting, self.waiting = self.waiting, {link: [] for link in self.waiting}
            plant.advance([rows for batches in waiting.values() for rows in batches])
            self.log_released()
            for device, release in plant.late() if self.options.paced else ():
                self.member.change("release", device, act=release)
        log = self.member.message_filter.log
        (log.info if plant.sound else log.error)(self.source.end(k, plant.sound))
        self.source.finish()


main = partial(
    run_node,
    "plant_sim",
    PlantSim,
    "The power system: publishes PMU frames, follows setpoints; alone it runs in mode free.",
)
