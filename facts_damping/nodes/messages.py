"""Between messages and the arrays that the compiled functions take: numbers pass unchanged, bit for bit.

Messages are made once and filled anew every tick.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from facts_damping_msgs.msg import (
    ControllerState,
    DeviceState,
    GridEvent,
    LinkChannelStatistics,
    LinkStatistics,
    MachineState,
    PlantState,
    PmuDataFrame,
    PmuFrame,
    VoltageSetpoint,
    VoltageSetpoints,
)

from facts_damping.loop import controller_names
from facts_damping.signals import CHANNELS, DELIVERY, DEVICE_TRUTH, MACHINE_TRUTH, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from builtin_interfaces.msg import Time
    from numpy.typing import NDArray

    from facts_damping.configuration import Case

UNITS = {"rotor_angle": "rad"}  # of the truth's fields; all others are p.u.


def set_time(time: Time, nanoseconds: int) -> None:
    """Write integer nanoseconds into a time message."""
    time.sec, time.nanosec = divmod(int(nanoseconds), NANOSECONDS)


def time_ns(time: Time) -> int:
    """A time message as integer nanoseconds."""
    return int(time.sec * NANOSECONDS + time.nanosec)


class Frames:
    """PMU data frames of a case: message to array and back."""

    def __init__(self, case: Case) -> None:
        """Prepare an entry a station."""
        self._stations = [station.name for station in case.system.stations]
        buses = {m.name: m.bus for m in case.system.machines}
        self._buses = [s.bus or buses[s.machine or ""] for s in case.system.stations]
        self._index = {name: i for i, name in enumerate(self._stations)}
        self._fields = [f"{name}_{unit}" for name, unit in CHANNELS.items()]
        self._message = PmuDataFrame()
        self._pool: list[list[PmuFrame]] = []
        self._frame_rate = case.run.frame_rate

    def _entry(self, station: int, uses: dict[int, int]) -> PmuFrame:
        """An unused entry of a station, made where there is none yet."""
        number = uses.get(station, 0)
        uses[station] = number + 1
        while len(self._pool) <= number:
            self._pool.append([PmuFrame(station=name) for name in self._stations])
            for entry, bus in zip(self._pool[-1], self._buses, strict=True):
                entry.header.frame_id = bus
        return self._pool[number][station]

    def fill(self, tick: int, start_ns: int, delivered: NDArray[Any], count: int) -> PmuDataFrame:
        """Message of `count` delivered entries; the same object every time."""
        uses: dict[int, int] = {}
        entries = []
        for row in delivered[:count]:
            entry = self._entry(int(row["station"]), uses)
            measured = int(row["measured_ns"])
            set_time(entry.header.stamp, measured)
            set_time(entry.arrival, row["arrival_ns"])
            entry.tick = -(-measured * self._frame_rate // NANOSECONDS)
            values = row["values"].tolist()
            for field, value in zip(self._fields, values, strict=True):
                setattr(entry, field, value)
            sound = all(math.isfinite(values[i]) for i in (0, 1, 3, 4))
            entry.status = 0 if sound else PmuFrame.STATUS_DATA_ERROR
            entries.append(entry)
        message = self._message
        set_time(message.header.stamp, start_ns)
        message.tick = tick
        message.fresh = count > 0
        message.frames = entries
        return message

    def read(self, message: PmuDataFrame) -> NDArray[Any]:
        """Entries of a message as rows of DELIVERY; an entry of an unknown station is passed over."""
        rows = np.zeros(len(message.frames), DELIVERY)
        count = 0
        for entry in message.frames:
            station = self._index.get(entry.station)
            if station is None:
                continue
            values = tuple(getattr(entry, field) for field in self._fields)
            rows[count] = (message.tick, station, time_ns(entry.header.stamp), time_ns(entry.arrival), values)
            count += 1
        return rows[:count]


class Setpoints:
    """Voltage setpoints of a case: message to array and back."""

    def __init__(self, case: Case) -> None:
        """Prepare names of devices and controllers."""
        self._devices = list(case.run.devices)
        self._places = {d.name: f"{d.from_bus}-{d.to_bus}" for d in case.system.devices}
        self._controllers = controller_names(case)

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], controller: str) -> VoltageSetpoints:
        """Message of setpoints; `controller` is empty as delivered by a link."""
        message = VoltageSetpoints(tick=tick, controller=controller, fresh=len(rows) > 0)
        set_time(message.header.stamp, start_ns)
        for row in rows:
            device = self._devices[row["device"]]
            entry = VoltageSetpoint(
                device=device, controller=self._controllers[row["controller"]], value_pu=float(row["value"])
            )
            entry.header.frame_id = self._places[device]
            set_time(entry.header.stamp, row["measured_ns"])
            set_time(entry.issued, row["issued_ns"])
            set_time(entry.effective, row["effective_ns"])
            message.setpoints.append(entry)
        return message

    def read(self, message: VoltageSetpoints) -> NDArray[Any]:
        """Setpoints of a message as rows of SETPOINT; those of unknown devices or controllers are passed over."""
        rows = [
            (
                message.tick,
                self._controllers.index(entry.controller),
                self._devices.index(entry.device),
                time_ns(entry.header.stamp),
                time_ns(entry.issued),
                time_ns(entry.effective),
                entry.value_pu,
            )
            for entry in message.setpoints
            if entry.device in self._devices and entry.controller in self._controllers
        ]
        return np.array(rows, SETPOINT)


class Truth:
    """The plant's state of a case as a message."""

    def __init__(self, case: Case) -> None:
        """Prepare an entry a machine and a device."""
        self._message = PlantState(
            machines=[MachineState(machine=m.name) for m in case.system.machines],
            devices=[DeviceState(device=name) for name in case.run.devices],
        )
        self._machine_fields = [f"{name}_{UNITS.get(name, 'pu')}" for name in MACHINE_TRUTH.names or ()]
        self._device_fields = [f"{name}_pu" for name in DEVICE_TRUTH.names or () if name != "blocked"]

    def fill(self, tick: int, start_ns: int, sound: bool, machines: NDArray[Any], devices: NDArray[Any]) -> PlantState:
        """Message of a tick; the same object every time."""
        message = self._message
        set_time(message.header.stamp, start_ns)
        message.tick = tick
        message.in_synchronism = bool(sound)
        for entry, row in zip(message.machines, machines.tolist(), strict=True):
            for field, value in zip(self._machine_fields, row, strict=True):
                setattr(entry, field, value)
        for entry, row in zip(message.devices, devices.tolist(), strict=True):
            for field, value in zip(self._device_fields, row[:-1], strict=True):
                setattr(entry, field, value)
            entry.blocked = row[-1] != 0.0
        return message


def grid_event(event: dict[str, Any]) -> GridEvent:
    """Message of an event of the grid."""
    message = GridEvent(kind=event["kind"], element=event["element"], value=event["value"], location=event["location"])
    set_time(message.header.stamp, event["time_ns"])
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


def controller_state(case: Case, index: int) -> ControllerState:
    """An empty state message of a controller, with its names."""
    controller = case.run.controllers[index]
    return ControllerState(
        controller=controller_names(case)[index],
        input_names=controller.signals,
        output_names=controller.devices,
    )
