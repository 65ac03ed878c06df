"""supervisor: subscribes to frames and a controller's setpoints, passes on permitted setpoints, publishes its state."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from facts_damping_msgs.msg import ControllerState, DeviceSetpoints, PlantState, SupervisorState
from std_srvs.srv import Trigger

from facts_damping.case.names import (
    SUPERVISED,
    controller_addresses,
    controller_names,
    identifier_names,
    link_addresses,
    supervisor_addresses,
)
from facts_damping.case.supervision import reserves
from facts_damping.control.table import kind_of
from facts_damping.monitor_table import (
    ARM,
    ARMED,
    COMMANDS,
    DISARM,
    DISARMED,
    FALLBACK,
    NO_CAUSE,
    PROBE,
    RESET,
    SHADOW,
    STATES,
    TRIPPED,
    cause_name,
    reason_of,
)
from facts_damping.nodes.admission.member import SUPERVISOR, Member
from facts_damping.nodes.admission.publishers import Reading
from facts_damping.nodes.base.parameters import read_case, read_index, read_options
from facts_damping.nodes.base.qos import PUBLISHER_QOS
from facts_damping.nodes.base.run import run_node
from facts_damping.nodes.base.topics import PLANT_STATE
from facts_damping.nodes.input_collector import InputCollector
from facts_damping.nodes.transport.messages import (
    ControllerStateMessage,
    Health,
    PlantStateMessage,
    SupervisorStateMessage,
)
from facts_damping.nodes.transport.tables import SetpointsMessage
from facts_damping.signals import DEVICE_TRUTH, NANOSECONDS, SETPOINT, SUPERVISION, Span
from facts_damping.simulation.assembly import build_supervisors
from facts_damping.simulation.loop import setpoint_buffer
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.supervision.state_machine import refusal
from facts_damping.supervision.step import supervise, write_status

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.nodes.base.managed import ManagedNode

LEVELS = {ARMED: DiagnosticStatus.OK, TRIPPED: DiagnosticStatus.ERROR}  # all other states: WARN
FROM = {ARM: (SHADOW,), DISARM: (SHADOW, ARMED, FALLBACK, TRIPPED), RESET: (DISARMED, TRIPPED), PROBE: (SHADOW,)}


class SupervisorNode:
    """The supervisor of one controller of the run."""

    def __init__(self, node: ManagedNode) -> None:
        self.case, self.options = read_case(node), read_options(node)
        addresses = supervisor_addresses(self.case)
        self.index = read_index(node, addresses, "supervised controllers")
        self.s = list(addresses).index(self.index)  # row of this supervisor in arrays
        self.supervisors, self.state = build_supervisors(self.case)
        self.row, self.thresholds = self.state.rows[self.s], self.supervisors.thresholds[self.s]
        address, self.devices_of = addresses[self.index], self.case.controllers[self.index].devices
        hardware = ", ".join(self.devices_of)
        self.member = Member(node, self.case, self.options, SUPERVISOR, self.index, address=address, hardware=hardware)
        self.name, self.status, self.before = address.name, np.zeros(1, SUPERVISION), -1
        self.sources = [c for c in (self.index, reserves(self.case.run).get(self.index)) if c is not None]
        self.controllers = [controller_names(self.case)[c] for c in self.sources]
        self.setpoints = SetpointsMessage(self.case, seal=self.member.seal(f"{address}/{SUPERVISED}"))
        self.to_link = node.create_publisher(DeviceSetpoints, f"{self.name}/{SUPERVISED}", PUBLISHER_QOS)
        self.to_recorder = node.create_publisher(SupervisorState, f"{self.name}/state", PUBLISHER_QOS)
        self.devices = np.zeros(len(self.case.run.devices), DEVICE_TRUTH)
        self.inputs, self.publishers = self.subscribe(node)
        self.state_message = SupervisorStateMessage(self.controllers[0], self.thresholds, list(self.inputs.latest))
        for name in COMMANDS:
            node.create_service(Trigger, f"~/{name}", partial(self.on_command, name))
        self.member.message_filter.subscribe_run_state()
        self.waits, self.takes_part = False, self.options.paced
        self.spinner, self.activation = self.member.spin(), self

    def subscribe(self, node: ManagedNode) -> tuple[InputCollector, dict[str, Callable[[], int]]]:
        """Subscribe to the link, the plant, the controller and its fallback.

        Returns the collector of their messages, and a function by part that counts its publishers.
        """
        case, member = self.case, self.member
        places, names = controller_addresses(case), controller_names(case)
        senders = {names[c]: str(places[c]) for c in self.sources} | {"plant": "plant_sim"}
        topics = {names[c]: f"{places[c]}/setpoints" for c in self.sources} | {"plant": PLANT_STATE}
        readers: dict[str, tuple[Any, Callable[[bytes], tuple[Any, ...]]]] = {
            "plant": (PlantState, PlantStateMessage(case).read)
        }
        if not kind_of(case.controllers[self.index]).node:  # a user's own node need not publish its state
            senders["state"], topics["state"] = str(places[self.index]), f"{places[self.index]}/state"
            readers["state"] = ControllerState, ControllerStateMessage(case, self.index).read
        inputs = InputCollector(self.options, senders, self.act)
        for c in self.sources:
            member.subscribe_setpoints(topics[names[c]], inputs.store(names[c]), names[c], [c])
        for part, (kind, read) in readers.items():
            member.message_filter.subscribe(kind, f"{member.graph}{topics[part]}", inputs.store(part), Reading(read))
        link = link_addresses(case)[case.used_links[self.index]]
        member.subscribe_frames(link.topic("pmu/delivered"), inputs.frames)
        return inputs, {part: partial(node.count_publishers, member.graph + topic) for part, topic in topics.items()}

    def ready(self) -> None:
        """Wait for its link, its controller and fallback, the identifier, and the recorder."""
        extra = int(self.options.recorder)
        identified = sum(c in identifier_names(self.case) for c in self.sources)
        self.member.wait({self.to_link: 1 + identified + extra, self.to_recorder: extra}, self.spinner)

    def run(self) -> None:
        """Serve until stopped."""
        self.inputs.spin(self.spinner, self.publishers)

    def act(self, tick: int, parts: dict[str, Any]) -> None:
        """Process one tick: publish the permitted setpoints, also if there are none, and the state when it is due."""
        self.member.begin(tick)
        row = self.row
        for health in parts.get("state", [])[-1:]:
            row["finite"], row["norm"], row["lyapunov"], row["fall"] = health
        for devices in parts["plant"][-1:]:
            self.devices[:] = devices
        issued_parts = [rows for name in self.controllers for rows in parts[name]]
        issued = np.concatenate([*issued_parts, np.zeros(0, SETPOINT)])
        start, end = (tick_ns(k, self.case.run.frame_rate) for k in (tick, tick + 1))
        out, span = setpoint_buffer(len(self.devices_of), len(issued)), Span(tick, start, end)
        this = self.supervisors, self.state, self.s
        count = supervise(*this, span, parts["frames"], issued, self.devices, out)
        self.to_link.publish(self.setpoints.fill(tick, start, out[:count], self.name))
        if write_status(*this, tick, self.status, 0):
            inputs = list(self.inputs.latest.values())
            self.to_recorder.publish(self.state_message.fill(tick, start, self.status[0], inputs))
            self.report(start)
        self.member.report_health(self.health)

    def report(self, start_ns: int) -> None:
        """Log a change of state; shadow is not logged."""
        state = int(self.status["state"][0])
        if state not in (self.before, SHADOW):
            log, reason = self.member.message_filter.log, reason_of(self.status[0], self.thresholds)
            text = f"{STATES[state]} at {start_ns / NANOSECONDS:.3f} s: {reason}"
            (log.warning if state in (FALLBACK, TRIPPED) else log.info)(text)
        self.before = state

    def health(self) -> Health:
        """State of the supervisor and its reason."""
        state = int(self.status["state"][0])
        reason = reason_of(self.status[0], self.thresholds)
        level = LEVELS.get(state, DiagnosticStatus.WARN)
        values = {"mode": self.options.mode, "state": STATES[state], "cause": cause_name(int(self.status["cause"][0]))}
        return Health(level, f"{STATES[state]}: {reason}" if reason else STATES[state], values)

    def activate(self) -> None:
        """Return to shadow if the supervisor is disarmed."""
        if self.row["state"] == DISARMED:
            self._ask("reset")

    def deactivate(self) -> None:
        """Disarm: the controller no longer acts."""
        if self.row["state"] != DISARMED:
            self._ask("disarm")

    def _ask(self, name: str) -> None:
        """Queue a command for the next tick."""

        def act(_tick: int) -> None:
            self.row["asked"] = COMMANDS[name]

        self.member.change(name, act=act)

    def on_command(self, name: str, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Queue an operator's command for the next tick, or answer why it is refused."""
        code, state = COMMANDS[name], int(self.row["state"])
        if state not in FROM[code]:
            allowed = ", ".join(STATES[allowed_state] for allowed_state in FROM[code])
            response.message = f"{STATES[state]}; allowed: {name} while {allowed}"
            return response
        if code == PROBE and not self.supervisors.settings["omega"][self.s] > 0.0:
            response.message = "not probed: the plant has no electromechanical mode"
            return response
        cause = refusal(self.supervisors, self.state, self.s) if code == ARM else NO_CAUSE
        if cause != NO_CAUSE:
            self.status["refused"] = cause
            response.message = f"not armed: {reason_of(self.status[0], self.thresholds, refused=True)}"
            return response
        self._ask(name)
        response.success, response.message = True, f"from tick {int(self.row['tick']) + 1} on"
        return response


main = partial(
    run_node, "supervisor", SupervisorNode, "The supervisor of a controller of the run: arms, trips and replaces it."
)
