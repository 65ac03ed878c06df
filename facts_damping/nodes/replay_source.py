"""replay_source: replaces plant and links by a recording; publishes the delivered frames tick by tick."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import DeviceSetpoints, PmuDataFrame, RunState

from facts_damping.case.names import (
    acting,
    identifier_names,
    link_addresses,
    listeners,
    recorded_topic,
    setpoint_senders,
)
from facts_damping.nodes.base.managed import AlwaysActive
from facts_damping.nodes.base.parameters import declare, descriptor, read_case, read_options
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.spinner import check_wanted
from facts_damping.nodes.frame_source import FrameSource
from facts_damping.nodes.transport.messages import grid_event
from facts_damping.nodes.transport.tables import SetpointsMessage
from facts_damping.recording.reader import load
from facts_damping.simulation.measured_plant import entries
from facts_damping.simulation.replaying.replay import acted, fitted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode


class ReplaySource:
    """Replays a recording and waits for the controllers' answers."""

    activation = AlwaysActive()

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options = read_case(node), read_options(node, joins=False)
        path: str = declare(node, "recording", "", descriptor("recording to be replayed"))
        self.record = fitted(load(path), self.case)
        self.setpoints, self.senders = SetpointsMessage(self.case), setpoint_senders(self.case)
        self.tick = -1
        self.source = FrameSource(node, self.case, self.options, path)
        self.member = self.source.member
        links, extra = link_addresses(self.case), int(self.options.recorder)
        self.delivered = [
            node.create_publisher(PmuDataFrame, link.topic("pmu/delivered"), PUBLISHER_QOS) for link in links
        ]
        self.applied = [
            node.create_publisher(DeviceSetpoints, link.topic("setpoints/delivered"), PUBLISHER_QOS) for link in links
        ]
        identified = [acting(self.case, c) for c in identifier_names(self.case)]  # identifiers need recorded setpoints
        self.recorded = {
            c: node.create_publisher(DeviceSetpoints, recorded_topic(self.senders[c].topic), PUBLISHER_QOS)
            for c in identified
        }
        for c, sender in self.senders.items():
            # One subscription in place of its link, and one for each identifier, which gets the recorded setpoints.
            answer = partial(self.on_setpoints, sender.place)
            for use in [answer, *[partial(_nothing)] * identified.count(c)]:
                self.member.subscribe_setpoints(sender.topic, use, sender.name, [c], lambda: self.tick)
            self.source.answered[sender.place] = -1
        self.spinner = self.member.spin()
        self.expected = dict.fromkeys(self.applied, extra)
        self.expected |= {self.delivered[i]: listeners(self.case, i) + extra for i in range(len(links))}
        self.expected |= {publisher: identified.count(c) for c, publisher in self.recorded.items()}

    def ready(self) -> None:
        """Wait for controllers and identifiers."""
        self.source.wait(self.spinner, 0, self.expected)

    def on_setpoints(self, sender: str, tick: int, _rows: NDArray[Any]) -> None:
        """Note the answer of a controller or its supervisor, which thus has the previous tick's estimates."""
        self.source.answered[sender] = tick

    def publish(self, at: int, tick: int, start: int) -> None:
        """Publish the recorded messages of a tick, first those that others wait for; `at`: row in the recording."""
        record, self.tick = self.record, tick
        arrived, issued, applied = (
            rows[slice(*np.searchsorted(rows["tick"], [tick, tick + 1]))]
            for rows in (record.delivered, acted(record), record.applied)
        )
        for link, publisher in enumerate(self.delivered):
            rows = np.ascontiguousarray(arrived[arrived["link"] == link])
            publisher.publish(self.source.frames_message.fill(tick, start, rows, len(rows)))
        for c, publisher in self.recorded.items():
            rows = issued[issued["controller"] == c]
            publisher.publish(self.setpoints.fill(tick, start, rows, self.senders[c].name))
        for link, publisher in enumerate(self.applied):
            rows = applied[np.array(self.case.used_links)[applied["controller"]] == link]
            publisher.publish(self.setpoints.fill(tick, start, rows, ""))
        reported = entries(start, record.frames[at], record.measured_ns[at], record.status[at])
        sound = bool(record.in_synchronism[at])
        self.source.publish(tick, reported, sound, record.machines[at], record.devices[at])

    def run(self) -> None:
        """Replay all ticks, each when all controllers have answered the one before."""
        events, ticks = list(self.record.events), self.record.ticks.tolist()
        self.source.ticks = len(ticks)
        self.source.publish_state(RunState.RUNNING, ticks[0], "begins")
        for at, (tick, start) in enumerate(zip(ticks, self.record.time_ns.tolist(), strict=True)):
            check_wanted()
            self.member.begin(tick)
            self.publish(at, tick, start)
            while events and events[0].time_ns <= start:
                self.source.to_events.publish(grid_event(events.pop(0)))
            self.source.wait_for_answers(self.spinner, tick, "no answer to")
            self.source.progress(at + 1, 0, now=at + 1 == len(ticks))
        self.source.end(ticks[-1], bool(self.record.in_synchronism[-1]))
        self.source.finish(*self.delivered, *self.applied)


def _nothing(_tick: int, _rows: NDArray[Any]) -> None:
    """Callback of a subscription that only stands in for an identifier's."""


main = partial(
    run_node, "replay_source", ReplaySource, "Takes the place of plant and links with a recording; lockstep."
)
