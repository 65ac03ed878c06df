"""The other messages of the graph: the truth, a controller's inner state, events, statistics, diagnostics."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from facts_damping_msgs.msg import (
    ControllerState,
    DeviceState,
    GridEvent,
    LinkChannelStatistics,
    LinkStatistics,
    MachineState,
    PlantState,
)

from facts_damping.loop import controller_names
from facts_damping.nodes.cdr import Template
from facts_damping.signals import DEVICE_TRUTH, MACHINE_TRUTH, NANOSECONDS

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from numpy.typing import NDArray

    from facts_damping.configuration import Case


class Truth:
    """The plant's state of a case."""

    def __init__(self, case: Case) -> None:
        """Lay out an entry a machine and a device."""
        machines = [MachineState(machine=m.name) for m in case.system.machines]
        devices = [DeviceState(device=name) for name in case.run.devices]
        self._template = t = Template(PlantState(machines=machines, devices=devices))
        units = {"rotor_angle": "rad"}  # of the truth's fields; all others are p.u.
        names = [f"{name}_{units.get(name, 'pu')}" for name in MACHINE_TRUTH.names or ()]
        self._machines = t.index(f"machines.{i}.{name}" for i in range(len(machines)) for name in names)
        self._devices = {
            name: t.index(f"devices.{i}.{name if name == 'blocked' else name + '_pu'}" for i in range(len(devices)))
            for name in (DEVICE_TRUTH.names or () if devices else ())
        }
        self._sound = t.index(["in_synchronism"])

    def fill(self, tick: int, start_ns: int, sound: bool, machines: NDArray[Any], devices: NDArray[Any]) -> bytes:
        """Message of a tick."""
        t = self._template
        t.write_head(start_ns, tick)
        t.write(self._sound, sound)
        t.write(self._machines, machines.view(np.float64))  # all fields are numbers of the same kind
        for name, field in self._devices.items():
            t.write(field, devices[name])
        return t.data()


class Inner:
    """The state of one controller of a case."""

    def __init__(self, case: Case, index: int) -> None:
        """Lay out its signals and devices."""
        controller = case.run.controllers[index]
        signals, devices = len(controller.signals), len(controller.devices)
        self._template = t = Template(
            ControllerState(
                controller=controller_names(case)[index],
                input_names=controller.signals,
                inputs=[0.0] * signals,
                output_names=controller.devices,
                unlimited_outputs=[0.0] * devices,
                outputs=[0.0] * devices,
                saturated=[False] * devices,
            )
        )
        self._fresh = t.index(["fresh"])
        self._inputs = t.index(f"inputs.{i}" for i in range(signals))
        self._outputs = [
            t.index(f"{name}.{i}" for i in range(devices)) for name in ("unlimited_outputs", "outputs", "saturated")
        ]

    def fill(
        self,
        tick: int,
        start_ns: int,
        fresh: bool,
        inputs: NDArray[Any],
        unlimited: NDArray[Any],
        outputs: NDArray[Any],
    ) -> bytes:
        """Message of a tick."""
        t = self._template
        t.write_head(start_ns, tick)
        t.write(self._fresh, fresh)
        t.write(self._inputs, inputs[: len(self._inputs.places)])
        count = len(self._outputs[0].places)
        for field, values in zip(self._outputs, (unlimited, outputs, outputs != unlimited), strict=True):
            t.write(field, values[:count])
        return t.data()


def set_time(time: Time, nanoseconds: int) -> None:
    """Write integer nanoseconds into a time message."""
    time.sec, time.nanosec = divmod(int(nanoseconds), NANOSECONDS)


def grid_event(event: dict[str, Any]) -> GridEvent:
    """Message of an event of the grid."""
    message = GridEvent(kind=event["kind"], element=event["element"], value=event["value"], location=event["location"])
    set_time(message.header.stamp, event["time_ns"])
    return message


def diagnostics(node: str, mode: str, misses: int, start_ns: int) -> DiagnosticArray:
    """Message of how a node keeps time."""
    status = DiagnosticStatus(name=node, level=DiagnosticStatus.WARN if misses else DiagnosticStatus.OK)
    status.message = f"{misses} deadline misses" if misses else "on time"
    status.values = [KeyValue(key="deadline_misses", value=str(misses)), KeyValue(key="mode", value=mode)]
    message = DiagnosticArray(status=[status])
    set_time(message.header.stamp, start_ns)
    return message


def link_statistics(
    tick: int, start_ns: int, up: dict[str, NDArray[Any]], down: dict[str, NDArray[Any]]
) -> LinkStatistics:
    """Message of a link's statistics, a row of STATISTICS a channel."""
    message = LinkStatistics(
        tick=tick,
        up=[_channel(name, row) for name, row in up.items()],
        down=[_channel(name, row) for name, row in down.items()],
    )
    set_time(message.header.stamp, start_ns)
    return message


def _channel(name: str, row: NDArray[Any]) -> LinkChannelStatistics:
    sent, delivered, lost, total, low, high = (int(value) for value in row.tolist())
    some = delivered > 0
    return LinkChannelStatistics(
        channel=name,
        sent=sent,
        delivered=delivered,
        lost=lost,
        in_flight=sent - delivered - lost,
        delay_mean_s=total / delivered / NANOSECONDS if some else math.nan,
        delay_min_s=low / NANOSECONDS if some else math.nan,
        delay_max_s=high / NANOSECONDS if some else math.nan,
    )
