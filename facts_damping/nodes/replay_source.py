"""replay_source: replaces plant and links by a recording; publishes the delivered frames tick by tick."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import DeviceSetpoints, GridEvent, PlantState, PmuDataFrame, RunState

from facts_damping.case.names import (
    acting,
    identifier_names,
    link_addresses,
    listeners,
    recorded_topic,
    speakers,
    supervisor_names,
)
from facts_damping.errors import RunError
from facts_damping.nodes.admission.member import PLANT, Member
from facts_damping.nodes.base.discovery import finish
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case, read_options
from facts_damping.nodes.base.qos import LATCHED, PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import check_wanted
from facts_damping.nodes.base.topics import STATE
from facts_damping.nodes.transport.messages import (
    PlantStateMessage,
    grid_event,
    run_done,
    state_message,
    synchronism_lost,
)
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.recording.reader import load
from facts_damping.simulation.measured_plant import entries
from facts_damping.simulation.replay import acted, fitted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode

PROGRESS_S = 0.2  # wall time between two progress lines


class ReplaySource:
    """Replays a recording and waits for the controllers' answers."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        """Read parameters and recording, set up the topics."""
        self.case, self.options = read_case(node), read_options(node, joins=False)
        path: str = declare(node, "recording", "", descriptor("recording to be replayed"))
        self.record = fitted(load(path), self.case)
        self.frames, self.setpoints, self.truth = (
            FramesMessage(self.case),
            SetpointsMessage(self.case),
            PlantStateMessage(self.case),
        )
        self.heard = speakers(self.case)
        links, extra = link_addresses(self.case), int(self.options.recorder)
        self.to_all = node.create_publisher(PmuDataFrame, "pmu/frames", PUBLISHER_QOS)
        self.to_state = node.create_publisher(PlantState, "plant/state", PUBLISHER_QOS)
        self.to_events = node.create_publisher(GridEvent, "plant/events", PUBLISHER_QOS)
        self.delivered = [
            node.create_publisher(PmuDataFrame, link.topic("pmu/delivered"), PUBLISHER_QOS) for link in links
        ]
        self.applied = [
            node.create_publisher(DeviceSetpoints, link.topic("setpoints/delivered"), PUBLISHER_QOS) for link in links
        ]
        hearing = [acting(self.case, c) for c in identifier_names(self.case)]
        self.recorded = {
            c: node.create_publisher(DeviceSetpoints, recorded_topic(self.heard[c].topic), PUBLISHER_QOS)
            for c in hearing
        }
        self.tick = -1
        self.member = Member(node, self.case, self.options, PLANT, hardware=path)
        self.state = node.create_publisher(RunState, STATE, LATCHED)
        for c, speaker in self.heard.items():
            # One subscription in place of its link, and one for each identifier, which gets the recorded setpoints.
            for i in range(1 + hearing.count(c)):
                use = partial(self.on_setpoints, speaker.place) if i == 0 else _nothing
                setpoints = SetpointsMessage(self.case, speaker.name, [c])
                self.member.message_filter.subscribe(
                    DeviceSetpoints, speaker.topic, use, setpoints.read, lambda: self.tick
                )
        self.answered = {speaker.place: -1 for speaker in self.heard.values()}
        self.spinner = self.member.spin()
        self.expected = dict.fromkeys((self.to_all, self.to_events, *self.applied), extra)
        self.expected[self.to_state] = extra + len(supervisor_names(self.case))
        self.expected |= {self.delivered[i]: listeners(self.case, i) + extra for i in range(len(links))}
        self.expected |= {publisher: hearing.count(c) for c, publisher in self.recorded.items()}

    def ready(self) -> None:
        """Wait for controllers and identifiers."""
        self.member.wait(self.expected, self.spinner)

    def on_setpoints(self, controller: str, tick: int, _rows: NDArray[Any]) -> None:
        """Note the answer of a controller or its supervisor, which thus has the previous tick's estimates."""
        self.answered[controller] = tick

    def publish(self, at: int, tick: int, start: int) -> None:
        """Publish the recorded messages of a tick, first those that others wait for; `at`: row in the recording."""
        record, self.tick = self.record, tick
        arrived, issued, applied = (
            rows[slice(*np.searchsorted(rows["tick"], [tick, tick + 1]))]
            for rows in (record.delivered, acted(record), record.applied)
        )
        for link, publisher in enumerate(self.delivered):
            rows = np.ascontiguousarray(arrived[arrived["link"] == link])
            publisher.publish(self.frames.fill(tick, start, rows, len(rows)))
        for c, publisher in self.recorded.items():
            rows = issued[issued["controller"] == c]
            publisher.publish(self.setpoints.fill(tick, start, rows, self.heard[c].name))
        for link, publisher in enumerate(self.applied):
            rows = applied[np.array(self.case.used_links)[applied["controller"]] == link]
            publisher.publish(self.setpoints.fill(tick, start, rows, ""))
        reported = entries(start, record.frames[at], record.measured_ns[at], record.status[at])
        self.to_all.publish(self.frames.fill(tick, start, reported, len(reported)))
        sound = bool(record.in_synchronism[at])
        self.to_state.publish(self.truth.fill(tick, start, sound, record.machines[at], record.devices[at]))

    def run(self) -> None:
        """Replay all ticks, each when all controllers have answered the one before."""
        events, ticks, reported_s = list(self.record.events), self.record.ticks.tolist(), -PROGRESS_S
        self.publish_state(RunState.RUNNING, 0, "begins")
        for at, (tick, start) in enumerate(zip(ticks, self.record.time_ns.tolist(), strict=True)):
            check_wanted()
            self.member.begin(tick)
            self.publish(at, tick, start)
            while events and events[0].time_ns <= start:
                self.to_events.publish(grid_event(events.pop(0)))
            self.wait(tick)
            if time.monotonic() - reported_s > PROGRESS_S or at + 1 == len(ticks):
                reported_s = time.monotonic()
                self.member.message_filter.log.line(f"tick {at + 1} {len(ticks)} 0")
        sound = bool(self.record.in_synchronism[-1])
        lost = synchronism_lost(int(self.record.time_ns[-1]))
        self.publish_state(RunState.ENDED, -1, run_done(ticks[-1], self.case.run.frame_rate) if sound else lost, sound)
        finish([*self.delivered, *self.applied, self.to_all, self.to_state, self.to_events], self.options.timeout)

    def publish_state(self, state: int, at: int, reason: str, sound: bool = True) -> None:
        """Publish the state of the run at row `at` of the recording, in place of the plant."""
        tick, start = int(self.record.ticks[at]), int(self.record.time_ns[at])
        self.state.publish(state_message(state, tick, start, reason, sound))

    def wait(self, tick: int) -> None:
        """Wait for the answers to a tick. Raises `RunError` naming silent nodes."""
        patience = self.options.patience(tick)
        deadline = time.monotonic() + patience + 1.0
        while min(self.answered.values()) < tick:
            if not self.spinner.spin_once(0.05) and time.monotonic() > deadline:
                who = ", ".join(name for name, newest in self.answered.items() if newest < tick)
                raise RunError(f"{who} is silent: no answer to tick {tick} within {patience:g} s")


def _nothing(_tick: int, _rows: NDArray[Any]) -> None:
    """Callback of a subscription that only stands in for an identifier's."""


def main() -> None:
    """Entry point."""
    run_node("replay_source", ReplaySource, "A recording in the place of plant and links; lockstep.")


if __name__ == "__main__":
    main()
