"""controller: subscribes to delivered frames, publishes setpoints and its state; a run has one MIMO or several MISO."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from facts_damping_msgs.msg import ControllerState, DeviceSetpoints, JacobianEstimate

from facts_damping.case.names import controller_addresses, identifier_addresses, link_addresses, supervisor_addresses
from facts_damping.control.bank import act, set_estimate
from facts_damping.control.table import kind_of
from facts_damping.nodes.admission.member import CONTROLLER, Member
from facts_damping.nodes.admission.publishers import Reading
from facts_damping.nodes.base import lines
from facts_damping.nodes.base.live_parameters import declare_settings
from facts_damping.nodes.base.parameters import read_case, read_index, read_options
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.weights_file import WeightsFile
from facts_damping.nodes.input_collector import UnitDelay
from facts_damping.nodes.transport.messages import ControllerStateMessage, Estimate, Estimates, Health
from facts_damping.nodes.transport.tables import SetpointsMessage
from facts_damping.simulation.adapted_weights import adapted
from facts_damping.simulation.assembly import build_control
from facts_damping.simulation.loop import setpoint_buffer
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.programs.policies import check, connect, step_times
from facts_damping.simulation.restarts import Restarts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.nodes.base.managed import ManagedNode
    from facts_damping.parameters.run import Weights


class ControllerNode:
    """One controller of the run."""

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options, self.weights = read_case(node), read_options(node), WeightsFile(node)
        self.index = read_index(node, range(len(self.case.controllers)))
        self.case = self.weights.start(self.case, self.index)
        self.controller = self.case.controllers[self.index]
        self.bank, self.state, _, _ = build_control(self.case)
        self.restarts = Restarts(self.bank, self.state)
        self.programs, self.late = connect(self.case, self.state, only=self.index), 0
        address, hardware = controller_addresses(self.case)[self.index], ", ".join(self.controller.devices)
        self.member = member = Member(
            node, self.case, self.options, CONTROLLER, self.index, address=address, hardware=hardware
        )
        if self.weights.resumed:
            member.change_weights(self.controller)
        names = [name for name in kind_of(self.controller).parameters if not name.startswith("identifier_")]
        rows, swing = self.bank.settings[self.index], self.bank.mode_shape[self.index]
        declare_settings(node, self.controller, names, rows, swing, member.change)
        link = link_addresses(self.case)[self.case.used_links[self.index]]
        identifier = str(identifier_addresses(self.case).get(self.index, ""))
        self.name, self.state_message = address.name, ControllerStateMessage(self.case, self.index)
        self.setpoints = SetpointsMessage(self.case, seal=member.seal(f"{address}/setpoints"))
        self.ticks = UnitDelay(self.options, self.case.run.frame_rate, identifier, self.act)
        self.to_link = node.create_publisher(DeviceSetpoints, f"{self.name}/setpoints", PUBLISHER_QOS)
        self.to_recorder = node.create_publisher(ControllerState, f"{self.name}/state", PUBLISHER_QOS)
        member.subscribe_frames(link.topic("pmu/delivered"), self.ticks.frames)
        if identifier:
            topic, estimates = f"{member.graph}{identifier}/estimate", Estimates(self.case, self.index)
            member.message_filter.subscribe(JacobianEstimate, topic, self.ticks.receive, Reading(estimates.read))
        member.message_filter.subscribe_run_state()
        self.spinner, self.activation = member.spin(), member.joining
        extra = int(self.options.recorder)
        guarded = len(supervisor_addresses(self.case)) > 0  # then only the supervisor subscribes to the setpoints
        state_too = guarded and self.controller.fallback_of is None  # the supervisor also subscribes to the state
        self.listeners = {self.to_link: 1 + bool(identifier and not guarded) + extra}
        self.listeners[self.to_recorder] = int(state_too) + extra

    def ready(self) -> None:
        """Wait for its link, its supervisor or identifier, and the recorder."""
        self.member.wait(self.listeners, self.spinner)

    def run(self) -> None:
        """Serve until stopped, then save the weights."""
        try:
            self.ticks.spin(self.spinner)
        finally:
            self.weights.keep(self.learnt, last=True)
            for times in step_times(self.programs).values():
                self.member.message_filter.log.line(lines.steps_line(times))

    def learnt(self) -> Weights | None:
        """The adapted weights; None if there are none."""
        return adapted(self.controller, self.index, self.state, None)

    def health(self) -> Health:
        """Whether frames arrive; for a user's own program also its step times."""
        rows = [times._asdict() for times in step_times(self.programs).values()]
        step_s = {name: f"{value:.6g}" for row in rows for name, value in row.items()}
        health = self.ticks.health("controls", controller=self.controller.name, **step_s)
        if replaced := self.replaced():
            health = Health(DiagnosticStatus.WARN, f"bad data: {', '.join(replaced)}", health.values)
        late, self.late = self.late, sum(program.late for program in self.programs)
        if not (self.options.paced and self.late > late):
            return health
        text = f"{self.late - late} steps of {self.controller.name} took longer than a frame"
        return Health(DiagnosticStatus.WARN, text, health.values | {"late_steps": self.late})

    def replaced(self) -> list[str]:
        """PMUs whose backups are used now, in words."""
        used, held, pmus = self.state_message.used, self.state.held, self.case.system.pmus
        rows = zip(used.pmu, held.source[self.index, used.signal, used.pmu], strict=True)
        return [f"{pmus[source].name} replaces {pmus[pmu].name}" for pmu, source in rows if pmu != source]

    def act(self, tick: int, delivered: NDArray[Any], estimates: list[Estimate]) -> None:
        """Process one tick: publish setpoints and state, also without frames; while disarmed, no setpoints."""
        c = self.index
        self.member.begin(tick)
        self.restarts.begin(tick)
        for estimate in estimates:
            set_estimate(self.state, c, *estimate)
        start = tick_ns(tick, self.case.run.frame_rate)
        issued = setpoint_buffer(len(self.controller.devices), len(delivered))
        count = act(self.bank, self.state, c, tick, delivered, len(delivered), issued, 0)
        check(self.programs)
        sent = count if self.member.joining.acts else 0
        self.to_link.publish(self.setpoints.fill(tick, start, issued[:sent], self.name))
        self.to_recorder.publish(
            self.state_message.fill(tick, start, len(delivered) > 0, self.state, self.ticks.latest)
        )
        self.member.report_health(self.health)
        self.weights.keep(self.learnt)


main = partial(
    run_node,
    "controller",
    ControllerNode,
    "One controller of the run: receives the delivered PMU frames, sends setpoints.",
)
