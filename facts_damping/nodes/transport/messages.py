"""Messages other than frames and setpoints: plant truth, controller state, events, statistics, diagnostics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from facts_damping_msgs import msg

from facts_damping.case.names import controller_names, identifier_names
from facts_damping.control.bank import controller_network
from facts_damping.control.inputs import candidates, inputs, sources
from facts_damping.monitor_table import MONITORS, OFF, STATES, cause_name
from facts_damping.neurofuzzy.start import groups
from facts_damping.nodes.transport.cdr import Field, Refused, Template, content
from facts_damping.nodes.transport.stamps import epoch_ns
from facts_damping.parameters.stages import Spoof
from facts_damping.signals import (
    DEVICE_TRUTH,
    MACHINE_TRUTH,
    NANOSECONDS,
    SUPERVISION_FIELDS,
    start_of,
    to_ns,
    truth_field,
)
from facts_damping.simulation.assembly import identifier_network

if TYPE_CHECKING:
    from collections.abc import Sequence

    from builtin_interfaces.msg import Time
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.bank import BankState
    from facts_damping.control.identifier_model import IdentifierState
    from facts_damping.record import GridEvent


M = TypeVar("M", bound=Any)  # a message


class PlantStateMessage:
    """PlantState messages of a case."""

    def __init__(self, case: Case) -> None:
        """Lay out one entry per machine and per device."""
        machines = [msg.MachineState(machine=m.name) for m in case.system.machines]
        devices = [msg.DeviceState(device=name) for name in case.run.devices]
        self._template = t = Template(msg.PlantState(machines=machines, devices=devices))
        names = [truth_field(name) for name in MACHINE_TRUTH.names or ()]
        self._machines = t.index(f"machines.{i}.{name}" for i in range(len(machines)) for name in names)
        self._devices = {
            name: t.index(f"devices.{i}.{truth_field(name)}" for i in range(len(devices)))
            for name in (DEVICE_TRUTH.names or () if devices else ())
        }
        self._sound, self._count = t.index(["in_synchronism"]), len(devices)

    def fill(self, tick: int, start_ns: int, sound: bool, machines: NDArray[Any], devices: NDArray[Any]) -> bytes:
        """Message of a tick; `sound`: in synchronism; `machines`, `devices`: MACHINE_TRUTH, DEVICE_TRUTH."""
        t = self._template
        t.write_head(start_ns, tick)
        t.write(self._sound, sound)
        t.write(self._machines, machines.view(np.float64))  # all fields are numbers of the same kind
        for name, field in self._devices.items():
            t.write(field, devices[name])
        return t.data()

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and devices (DEVICE_TRUTH) of a message. Raises `Refused` if it does not fit the case."""
        t = self._template
        t.take(data)
        devices = np.zeros(self._count, DEVICE_TRUTH)
        for name, field in self._devices.items():
            devices[name] = t.read(field)
        return t.tick(), devices


class ControllerStateMessage:
    """ControllerState messages of one controller of a case."""

    def __init__(self, case: Case, index: int) -> None:
        """Lay out signals, devices and the parameters of the neuro-fuzzy network."""
        controller = case.controllers[index]
        signals, devices = len(controller.signals), len(controller.devices)
        self._net = controller_network(controller)
        names, outputs = groups(self._net), self._net.outputs
        pmus = [pmu.name for pmu in case.system.pmus]
        receivers, _ = inputs([controller.signals], case.system.signals, pmus)
        self.used = candidates(receivers, 0)
        sizes = {
            **dict.fromkeys(("unlimited_outputs", "outputs", "saturated"), devices),
            "inputs": signals,
            "sources": len(self.used.pmu),
            "adaptation_errors": outputs,
            "firing_strengths": self._net.rules,
            "parameter_norms": len(names),
            "learning_rates": outputs * len(names),
        }
        message = msg.ControllerState(controller=controller_names(case)[index], parameter_groups=names)
        message.input_names, message.output_names = controller.signals, controller.devices
        message.pmus = [pmus[s] for s in self.used.pmu]
        message.latest = ["estimate"] if index in identifier_names(case) else []
        message.latest_ticks = [-1] * len(message.latest)
        for name, size in sizes.items():
            setattr(message, name, [{"saturated": False, "sources": 0}.get(name, 0.0)] * size)
        self._template = t = Template(message)
        self._index, self._devices, self._groups = index, devices, len(names)
        self._flags = t.index(["fresh"]), t.index(["learnt"])
        self._latest = t.index(f"latest_ticks.{i}" for i in range(len(message.latest)))
        self._lyapunov = t.index(["lyapunov", "lyapunov_fall"])
        self._fields = {name: t.index(f"{name}.{i}" for i in range(size)) for name, size in sizes.items()}

    def fill(self, tick: int, start_ns: int, fresh: bool, state: BankState, latest: int = -1) -> bytes:
        """Message of a tick; `fresh`: frames were delivered; `latest`: tick of the newest estimate used."""
        t, c, fields, net, learner = self._template, self._index, self._fields, self._net, state.learner
        t.write_head(start_ns, tick)
        for field, value in zip(self._flags, (fresh, fresh and state.memory.taught[c, 0]), strict=True):
            t.write(field, value)
        t.write(self._latest, latest)
        unlimited, outputs = state.unlimited[c, : self._devices], state.outputs[c, : self._devices]
        t.write(fields["inputs"], state.held.signal[c, : len(fields["inputs"].places)])
        t.write(fields["sources"], sources(self.used, state.held, c))
        t.write(fields["unlimited_outputs"], unlimited)
        t.write(fields["outputs"], outputs)
        t.write(fields["saturated"], outputs != unlimited)
        if net.rules:
            squares = np.bincount(learner.group[c, : net.size], learner.theta[c, : net.size] ** 2)
            t.write(fields["adaptation_errors"], state.memory.error[c, : net.outputs])
            t.write(fields["firing_strengths"], learner.passed.firing[c, : net.rules])
            t.write(fields["parameter_norms"], np.sqrt(squares))
            t.write(fields["learning_rates"], learner.rate[c, : net.outputs, : self._groups].ravel())
            t.write(self._lyapunov, state.memory.lyapunov[c])
        return t.data()

    def read(self, data: bytes) -> tuple[int, tuple[bool, float, float, float]]:
        """Tick and health for the supervisor: outputs finite, norm of the parameters, Lyapunov function and its fall.

        Raises `Refused` if the message does not fit the case.
        """
        t = self._template
        t.take(data)
        finite, square = bool(np.isfinite(t.read(self._fields["unlimited_outputs"])).all()), 0.0
        for norm in t.read(self._fields["parameter_norms"]).tolist():
            square += norm * norm
        lyapunov, fall = t.read(self._lyapunov).tolist()
        return t.tick(), (finite, math.sqrt(square), lyapunov, fall)


class SupervisorStateMessage:
    """SupervisorState messages of one supervisor of a case."""

    def __init__(self, controller: str, thresholds: NDArray[Any], latest: Sequence[str]) -> None:
        """`controller`: name; `thresholds`: of the supervisor's monitors; `latest`: names of its inputs."""
        self._controller, self._latest = controller, list(latest)
        self._limits = np.where(thresholds["follows"] == OFF, np.nan, thresholds["limit"])
        self._templates: dict[tuple[int, int, int], tuple[Template, Field, Field, Field]] = {}

    def fill(self, tick: int, start_ns: int, row: Any, latest: Sequence[int]) -> bytes:
        """Message of a tick; `row`: of SUPERVISION; `latest`: ticks of the newest inputs used."""
        key = int(row["state"]), int(row["cause"]), int(row["refused"])
        if key not in self._templates:
            self._templates[key] = self._laid_out(*key)
        t, values, others, ticks = self._templates[key]
        t.write_head(start_ns, tick)
        t.write(values, row["values"])
        t.write(others, [row[name] for name in SUPERVISION_FIELDS])
        t.write(ticks, latest)
        return t.data()

    def _laid_out(self, state: int, cause: int, refused: int) -> tuple[Template, Field, Field, Field]:
        message = msg.SupervisorState(controller=self._controller, state=STATES[state])
        message.cause, message.refused = cause_name(cause), cause_name(refused)
        message.monitors, message.limits = list(MONITORS), self._limits.tolist()
        message.values = [0.0] * len(MONITORS)
        message.latest, message.latest_ticks = self._latest, [-1] * len(self._latest)
        t = Template(message)
        ticks = t.index(f"latest_ticks.{i}" for i in range(len(self._latest)))
        return t, t.index(f"values.{i}" for i in range(len(MONITORS))), t.index(SUPERVISION_FIELDS.values()), ticks


class Estimate(NamedTuple):
    """Estimate of an identifier for its controller, as `bank.set_estimate` takes it."""

    jacobian: NDArray[np.float64]  # (signals, devices), p.u./p.u.
    change: NDArray[np.float64]  # (signals,), p.u.
    measured_ns: int  # time of measurement of the newest frame used


class Estimates:
    """JacobianEstimate messages of one identifier of a case."""

    def __init__(self, case: Case, index: int) -> None:
        """Lay out the signals and devices of the identifier's controller."""
        controller = case.controllers[index]
        self._rate = case.run.frame_rate
        stages = case.links[case.used_links[index]].up  # a spoofing stage may give later stamps
        self._ahead_ns = sum(to_ns(max(0.0, stage.offset)) for stage in stages if isinstance(stage, Spoof))
        self._shape = p, q = len(controller.signals), len(controller.devices)
        names = groups(identifier_network(controller)) if controller.scheme == "indirect" else []
        self._groups = len(names)
        self._template = t = Template(
            msg.JacobianEstimate(
                identifier=identifier_names(case)[index],
                latest=["setpoints"],
                latest_ticks=[-1],
                output_names=controller.signals,
                input_names=controller.devices,
                jacobian=[0.0] * (p * q),
                prediction=[0.0] * p,
                error=[0.0] * p,
                change=[0.0] * p,
                parameter_groups=names,
                learning_rates=[0.0] * (p * len(names)),
            )
        )
        self._rates = t.index(f"learning_rates.{i}" for i in range(p * len(names)))
        self._lyapunov, self._latest = t.index(["lyapunov", "lyapunov_fall"]), t.index(["latest_ticks.0"])
        self._jacobian, self._ahead = t.index(f"jacobian.{i}" for i in range(p * q)), t.index(["ahead"])
        self._by_signal = {name: t.index(f"{name}.{i}" for i in range(p)) for name in ("prediction", "error", "change")}

    def fill(self, tick: int, rows: NDArray[Any], state: IdentifierState, n: int, latest: int = -1) -> bytes:
        """Message of a tick; `rows`: ESTIMATE, signal by signal; `state`, `n`: learning state of identifier n.

        `latest`: tick of the newest setpoints used.
        """
        t = self._template
        t.write_head(int(rows["measured_ns"][0]), tick)
        t.write(self._jacobian, rows["jacobian"])
        t.write(self._latest, latest)
        for name, field in self._by_signal.items():
            t.write(field, rows[name][:: self._shape[1]])
        t.write(self._ahead, rows["ahead"][0])
        t.write(self._rates, state.learner.rate[n, : self._shape[0], : self._groups].ravel())
        t.write(self._lyapunov, state.lyapunov[n])
        return t.data()

    def read(self, data: bytes) -> tuple[int, Estimate]:
        """Tick and estimate of a message. Raises `Refused` if it does not fit the case or its stamp is too late."""
        t = self._template
        t.take(data)
        if t.start_ns() >= start_of(t.tick() + 1, self._rate) + self._ahead_ns:
            raise Refused("stamp")
        jacobian = t.read(self._jacobian).reshape(self._shape)
        return t.tick(), Estimate(jacobian, t.read(self._by_signal["change"]), t.start_ns())


def set_time(time: Time, nanoseconds: int) -> None:
    """Write simulated time, ns, into a time message; with `stamp: wall` it becomes wall time."""
    time.sec, time.nanosec = divmod(int(nanoseconds) + epoch_ns(), NANOSECONDS)


def stamped(message: M, start_ns: int) -> M:
    """The message with simulated time, ns, in its header."""
    set_time(message.header.stamp, start_ns)
    return message


def grid_event(event: GridEvent) -> msg.GridEvent:
    """Message of a grid event."""
    message = msg.GridEvent(kind=event.kind, element=event.element, value=event.value, location=event.location)
    return stamped(message, event.time_ns)


class Health(NamedTuple):
    """State of a node for `/diagnostics`."""

    level: bytes  # DiagnosticStatus.OK, WARN or ERROR
    message: str
    values: dict[str, Any]


def diagnostics(node: str, hardware: str, health: Health, start_ns: int) -> DiagnosticArray:
    """Diagnostics message of a node; `hardware`: what it represents or commands."""
    status = DiagnosticStatus(name=node, hardware_id=hardware, level=health.level, message=health.message)
    status.values = [KeyValue(key=key, value=str(value)) for key, value in health.values.items()]
    return stamped(DiagnosticArray(status=[status]), start_ns)


def run_state(data: bytes) -> tuple[int, bool, str]:
    """State, synchronism and reason of a RunState message. Raises `Refused` if it is no such message."""
    state = content(data, msg.RunState)
    return state.state, bool(state.in_synchronism), state.reason


def synchronism_lost(at_ns: int) -> str:
    """Text of every node for a loss of synchronism."""
    return f"synchronism lost at {at_ns / NANOSECONDS:.3f} s"


def link_statistics(
    tick: int, start_ns: int, up: dict[str, NDArray[Any]], down: dict[str, NDArray[Any]]
) -> msg.LinkStatistics:
    """Message of a link's statistics; `up`, `down`: a row of STATISTICS per channel."""
    up_rows, down_rows = ([_channel(name, row) for name, row in rows.items()] for rows in (up, down))
    return stamped(msg.LinkStatistics(tick=tick, up=up_rows, down=down_rows), start_ns)


def _channel(name: str, row: NDArray[Any]) -> msg.LinkChannelStatistics:
    sent, delivered, lost, duplicated, held, total, low, high = (int(value) for value in row.tolist())
    delays_ns = (total / delivered, low, high) if delivered > 0 else (math.nan,) * 3
    counts = {"sent": sent, "delivered": delivered, "lost": lost, "duplicated": duplicated, "held": held}
    names = ("delay_mean_s", "delay_min_s", "delay_max_s")
    delays = {name: delay_ns / NANOSECONDS for name, delay_ns in zip(names, delays_ns, strict=True)}
    in_flight = sent + duplicated + held - delivered - lost
    return msg.LinkChannelStatistics(channel=name, **counts, in_flight=in_flight, **delays)
