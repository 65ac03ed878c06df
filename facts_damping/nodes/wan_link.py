"""wan_link: delivers PMU data frames to its controllers and their setpoints to the plant, with the link's delays."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from facts_damping_msgs.msg import DeviceSetpoints, LinkStatistics, PmuDataFrame
from facts_damping_msgs.srv import Apply

from facts_damping.case.names import link_addresses, listeners, served, setpoint_senders
from facts_damping.errors import InputError, RunError, one_line
from facts_damping.link.transfer import RING_NO_ROOM, downlink, uplink
from facts_damping.nodes import clock
from facts_damping.nodes.admission.member import LINK, Member
from facts_damping.nodes.base.live_parameters import StageParameters
from facts_damping.nodes.base.parameters import read_case, read_index, read_options
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.topics import FRAMES
from facts_damping.nodes.transport.messages import Health, link_statistics
from facts_damping.nodes.transport.tables import FramesMessage, SetpointsMessage
from facts_damping.signals import CHANNELS, NEVER, SETPOINT
from facts_damping.simulation.assembly import build_links
from facts_damping.simulation.changes import relinked, renumbered, with_link
from facts_damping.simulation.measured_plant import tick_ns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode


PATIENCE_S = 2.0  # added to the time-out for the plant, which names other silent links 1 s after its own time-out


class WanLink:
    """One link of the run, both directions, and the messages of the current tick."""

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options = read_case(node), read_options(node)
        self.index = read_index(node, range(len(self.case.links)), "links")
        address = link_addresses(self.case)[self.index]
        self.member = member = Member(
            node, self.case, self.options, LINK, self.index, address=address, hardware=str(address)
        )
        self.links, self.now = build_links(self.case), self.case  # `now`: case as changed during the run
        self.stages = StageParameters(node, self.case.links[self.index], self.change_number)
        node.create_service(Apply, "~/apply", self.on_apply)
        self.frames = FramesMessage(self.case, member.seal(address.topic("pmu/delivered")))
        self.setpoints = SetpointsMessage(self.case, seal=member.seal(address.topic("setpoints/delivered")))
        senders = {c: sender for c, sender in setpoint_senders(self.case).items() if c in served(self.case, self.index)}
        self.places = {sender.name: sender.place for sender in senders.values()}
        self.frame = np.full((len(self.case.system.pmus), len(CHANNELS)), np.nan)
        self.measured_ns = np.full(len(self.frame), NEVER)  # NEVER: the PMU is absent from the frame
        self.status = np.zeros(len(self.frame), np.int64)
        self.to_controllers = node.create_publisher(PmuDataFrame, "pmu/delivered", PUBLISHER_QOS)
        self.to_plant = node.create_publisher(DeviceSetpoints, "setpoints/delivered", PUBLISHER_QOS)
        self.to_recorder = node.create_publisher(LinkStatistics, "link/statistics", PUBLISHER_QOS)
        member.subscribe_frames(FRAMES, self.on_frame)
        for c, (name, _, topic) in senders.items():
            member.subscribe_setpoints(topic, partial(self.on_setpoints, name), name, [c], lambda: self.tick)
        self.tick = -1
        self.missing: set[str] = set()
        self.answered = dict.fromkeys(self.places, 0)  # newest answered tick, by controller
        self.behind: Counter[str] = Counter()  # late answers since the last report, by controller
        self.topics = {sender.name: f"{member.graph}{sender.topic}" for sender in senders.values()}
        self.count_publishers = node.count_publishers
        self.received: dict[str, list[NDArray[Any]]] = {name: [] for name in self.places}
        member.message_filter.subscribe_run_state(FRAMES)
        self.spinner, self.activation = member.spin(), member.joining

    def ready(self) -> None:
        """Wait for the plant, the subscribers of delivered frames, and the recorder."""
        extra = int(self.options.recorder)
        expected = {self.to_controllers: listeners(self.case, self.index) + extra}
        expected |= {self.to_plant: 1 + extra, self.to_recorder: extra}
        self.member.wait(expected, self.spinner)

    def change_number(self, name: str, value: float) -> None:
        """Queue a new value of a stage's number; it acts on messages sent from the next tick on."""

        def act(_tick: int) -> None:
            self.links, self.now = renumbered(self.links, self.now, self.index, name, value)

        self.member.change("parameter", name, value, act)

    def on_apply(self, request: Apply.Request, response: Apply.Response) -> Apply.Response:
        """Replace the link by another one from the next tick on."""
        try:
            changed = with_link(self.now, self.index, request.change)
        except InputError as error:
            response.message = one_line(error)
            return response

        def act(_tick: int) -> None:
            self.now, self.links = changed, relinked(self.links, changed, self.index)

        self.stages.replace(changed.links[self.index])
        self.member.change("link", "", changed.links[self.index].model_dump(), act)  # in full, not by name
        response.success, response.message = True, f"from tick {self.tick + 1} on"
        return response

    def health(self) -> Health:
        """Controllers that do not answer or answer late."""
        silent = ", ".join(sorted(self.places[name] for name in self.places if self.late(name)))
        late = ", ".join(f"{count} of {self.places[name]}" for name, count in self.behind.items())
        self.behind.clear()
        flaws = [f"no answer from {silent}"] if silent else []
        flaws += [f"late answers: {late}"] if late else []
        level = DiagnosticStatus.WARN if flaws else DiagnosticStatus.OK
        return Health(level, "; ".join(flaws) or "delivers", {"mode": self.options.mode, "tick": self.tick})

    def late(self, controller: str) -> bool:
        """Whether a controller has not answered for a second."""
        return self.tick - self.answered[controller] > self.case.run.frame_rate

    def span(self, tick: int) -> tuple[int, int]:
        """Start and end of a tick, ns."""
        rate = self.case.run.frame_rate
        return tick_ns(tick, rate), tick_ns(tick + 1, rate)

    def on_frame(self, tick: int, rows: NDArray[Any]) -> None:
        """Begin a tick: put its frame into the uplink and publish the frames that arrive in it."""
        if self.missing:
            self.answer()  # paced by the clock, the plant does not wait for late controllers
        self.tick = tick
        self.member.begin(tick)
        start, end = self.span(self.tick)
        self.measured_ns[:] = NEVER
        self.frame[rows["pmu"]], self.measured_ns[rows["pmu"]] = rows["values"], rows["measured_ns"]
        self.status[rows["pmu"]] = rows["status"]
        measured = self.frame, self.measured_ns, self.status
        count = uplink(self.links, self.index, self.tick, start, end, *measured)
        self.to_controllers.publish(self.frames.fill(self.tick, start, self.links.up.out[self.index], count))
        self.missing = {name for name in self.places if not self.gone(name)}
        if not self.missing:
            self.answer()

    def gone(self, controller: str) -> bool:
        """Whether the link, paced by the clock, does not wait for a controller that has been silent for a second."""
        return self.options.paced and self.late(controller)

    def on_setpoints(self, controller: str, tick: int, rows: NDArray[Any]) -> None:
        """Keep a controller's setpoints; when the last controller has answered, answer the plant."""
        self.received[controller].append(rows)
        self.answered[controller] = tick
        if tick < self.tick:
            self.behind[controller] += 1
        if tick == self.tick and self.missing:
            self.missing.discard(controller)
            if not self.missing:
                self.answer()

    def answer(self) -> None:
        """Put the setpoints into the downlink, in order of controllers; publish those that arrive, none if disarmed."""
        start, end = self.span(self.tick)
        received = np.concatenate([np.zeros(0, SETPOINT), *(rows for held in self.received.values() for rows in held)])
        for held in self.received.values():
            held.clear()
        count = downlink(self.links, self.index, self.tick, end, received, len(received))
        sent = count if self.member.joining.acts else 0
        self.to_plant.publish(self.setpoints.fill(self.tick, start, self.links.down.out[self.index, :sent], ""))
        self.missing = set()
        lost = int(self.links.up.ring[self.index, RING_NO_ROOM] + self.links.down.ring[self.index, RING_NO_ROOM])
        if lost and not self.options.paced:
            raise RunError(f"{lost} entries did not fit into the buffer; delays are longer than planned")
        if (self.tick + 1) % self.case.run.frame_rate == 0:
            self.publish_statistics()
        self.member.report_health(self.health)

    def publish_statistics(self) -> None:
        """Publish delays and losses of all channels so far."""
        up_rows, down_rows = (way.statistics[self.index] for way in (self.links.up, self.links.down))
        up = dict(zip([s.name for s in self.case.system.pmus], up_rows, strict=True))
        down = dict(zip(self.case.run.devices, down_rows, strict=False))
        self.to_recorder.publish(link_statistics(self.tick, self.span(self.tick)[0], up, down))

    def run(self) -> None:
        """Serve until stopped. In lockstep, raises `RunError` naming the node that is silent or has left."""
        while True:
            if self.spinner.spin_once(0.1):
                continue
            patience = self.options.patience(self.tick) + (0.0 if self.missing else PATIENCE_S)
            if self.owed() and clock.monotonic() - self.member.message_filter.admitted_at > patience:
                left = [name for name in self.missing if self.count_publishers(self.topics[name]) == 0]
                names = ", ".join(sorted(self.places[name] for name in left or self.missing)) or "plant_sim"
                what = "has left" if left else "is silent"
                raise RunError(f"{names} {what}: nothing after tick {self.tick} within {patience:g} s")

    def owed(self) -> bool:
        """Whether, in lockstep, setpoints of a controller or the plant's next frame are due."""
        if self.options.paced or self.tick < 0 or self.member.message_filter.over:
            return False
        return bool(self.missing) or self.tick + 1 < self.case.ticks


main = partial(
    run_node, "wan_link", WanLink, "A wide-area link: delivers PMU frames to controllers and setpoints to the plant."
)
