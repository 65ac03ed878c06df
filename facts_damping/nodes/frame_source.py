"""What plant_sim, c37118_client and replay_source have in common: the plant's topics, answers of others, progress."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping_msgs.msg import GridEvent, PlantState, PmuDataFrame, RunState
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from facts_damping.case.names import link_addresses, served, supervisor_names
from facts_damping.errors import RunError, one_line
from facts_damping.nodes import clock
from facts_damping.nodes.admission.member import PLANT, Member
from facts_damping.nodes.base import lines
from facts_damping.nodes.base.discovery import finish
from facts_damping.nodes.base.qos import LATCHED, PUBLISHER_QOS
from facts_damping.nodes.base.spinner import Stopped
from facts_damping.nodes.base.topics import FRAMES, PLANT_STATE, RUN_STATE
from facts_damping.nodes.transport.messages import PlantStateMessage, set_time, stamped, synchronism_lost
from facts_damping.nodes.transport.tables import FramesMessage
from facts_damping.recording.events import FAILED, STOPPED
from facts_damping.signals import NANOSECONDS
from facts_damping.simulation.measured_plant import tick_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from numpy.typing import NDArray
    from rclpy.lifecycle import LifecycleNode
    from rclpy.publisher import Publisher

    from facts_damping.case.model import Case
    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.base.spinner import Spinner

FAILED_S = 0.5  # longest wall time that a plant which failed waits for readers of the reason
PROGRESS_S = 0.2  # wall time between two progress lines
CLOCK_QOS = QoSProfile(depth=1)  # reliable; a slow subscriber gets only the newest time


class SimulatedClock:
    """Publishes the start of each tick on `/clock`, which is global, for nodes with `use_sim_time`."""

    def __init__(self, node: LifecycleNode) -> None:
        self._publisher, self._message = node.create_publisher(Clock, "/clock", CLOCK_QOS), Clock()

    def publish(self, start_ns: int) -> None:
        """Publish the start of a tick; with `stamp: wall` it becomes wall time."""
        set_time(self._message.clock, start_ns)
        self._publisher.publish(self._message)


class FrameSource:
    """Publishes frames, truth, events and the state of the run; notes who has answered."""

    def __init__(self, node: LifecycleNode, case: Case, options: Options, hardware: str) -> None:
        """`hardware`: what the node represents, for diagnostics."""
        self.member = Member(node, case, options, PLANT, hardware=hardware)
        self._case, self._options, self._log = case, options, self.member.message_filter.log
        self.frames_message = FramesMessage(case, self.member.seal(FRAMES))
        self._truth = PlantStateMessage(case)
        self._to_links = node.create_publisher(PmuDataFrame, FRAMES, PUBLISHER_QOS)
        self._to_all = node.create_publisher(PlantState, PLANT_STATE, PUBLISHER_QOS)
        self.to_events = node.create_publisher(GridEvent, "plant/events", PUBLISHER_QOS)
        self._to_state = node.create_publisher(RunState, RUN_STATE, LATCHED)
        self.ticks = case.ticks if options.ends(case) else sys.maxsize
        self.answered: dict[str, int] = {}  # tick of the newest answer, by node
        self._reported_s = -PROGRESS_S

    def subscribe_links(self, use: Callable[[str, int, NDArray[Any]], None], newest: Callable[[], int]) -> None:
        """Subscribe to the setpoints that links deliver: `use(link, tick, rows)`; `newest`: as in MessageFilter."""
        for i, link in enumerate(link_addresses(self._case)):
            self.answered[str(link)] = -1
            take, topic = partial(use, str(link)), link.topic("setpoints/delivered")
            self.member.subscribe_setpoints(topic, take, of=served(self._case, i), newest=newest)

    def wait(self, spinner: Spinner, links: int, others: Mapping[Publisher[Any], int] | None = None) -> None:
        """Wait for the readers of frames, supervisors, the recorder, and `others` by publisher."""
        extra = int(self._options.recorder)
        expected = {self._to_links: links + extra, self._to_all: len(supervisor_names(self._case)) + extra}
        expected |= {self.to_events: extra, self._to_state: extra, **(others or {})}
        self.member.wait(expected, spinner)

    def publish(
        self, tick: int, rows: NDArray[Any], sound: bool, machines: NDArray[Any], devices: NDArray[Any]
    ) -> None:
        """Publish PMU reports and truth of a tick; the frame first, since others wait for it."""
        start_ns = tick_ns(tick, self._case.run.frame_rate)
        self._to_links.publish(self.frames_message.fill(tick, start_ns, rows, len(rows)))
        self._to_all.publish(self._truth.fill(tick, start_ns, sound, machines, devices))

    def publish_state(self, state: int, tick: int, reason: str, sound: bool = True) -> None:
        """Publish the state of the run at a tick; `sound`: in synchronism."""
        message = RunState(state=state, tick=max(tick, 0), reason=reason, in_synchronism=sound)
        self._to_state.publish(stamped(message, tick_ns(max(tick, 0), self._case.run.frame_rate)))

    def progress(self, done: int, misses: int, now: bool = True) -> None:
        """Write a line of progress for the program that runs the graph.

        If not `now`: unless the last one is younger than `PROGRESS_S`.
        """
        if now or clock.monotonic() - self._reported_s > PROGRESS_S:
            self._reported_s = clock.monotonic()
            self._log.line(lines.ticks_line(lines.Ticks(done, self.ticks, misses)))

    def wait_for_answers(self, spinner: Spinner, tick: int, what: str) -> None:
        """Wait until all have answered a tick. Raises `RunError` naming silent nodes; `what`: missing message."""
        # A link waits less long for a silent controller, so it gives up first and names the controller.
        patience = self._options.patience(tick)
        deadline = clock.monotonic() + patience + 1.0
        while min(self.answered.values()) < tick:
            if not spinner.spin_once(0.05) and clock.monotonic() > deadline:
                who = ", ".join(name for name, newest in self.answered.items() if newest < tick)
                raise RunError(f"{who} is silent: {what} tick {tick} within {patience:g} s")

    @contextmanager
    def until_end(self, tick: Callable[[], int]) -> Iterator[None]:
        """Publish why the run in the context ends early: stopped (one without end counts as done), or failed.

        `tick`: returns the newest one.
        """
        try:
            yield
        except Stopped:
            reason = self._done(tick()) if self.ticks == sys.maxsize else STOPPED
            self.publish_state(RunState.ENDED, tick(), reason)
            raise
        except RunError as error:
            self.publish_state(RunState.ENDED, tick(), f"{FAILED}{one_line(error)}")
            finish([self._to_state], FAILED_S)
            raise

    def end(self, tick: int, sound: bool = True) -> str:
        """Publish that the run has ended after a tick. Returns the reason."""
        reason = self._done(tick) if sound else synchronism_lost(tick_ns(tick, self._case.run.frame_rate))
        self.publish_state(RunState.ENDED, tick, reason, sound)
        return reason

    def finish(self, *others: Publisher[Any]) -> None:
        """Wait, at most for the time-out, until all messages are received."""
        finish([*others, self._to_links, self._to_all, self.to_events, self._to_state], self._options.timeout)

    def _done(self, tick: int) -> str:
        return f"done: {tick_ns(tick + 1, self._case.run.frame_rate) / NANOSECONDS:g} s"
