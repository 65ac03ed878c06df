"""What goes over the wire every tick: frames and setpoints, between arrays and bytes, bit for bit.

A message with a table of entries has a shape (whose entries, in which order); each shape that comes up
is laid out once (`cdr.Template`) and then written and read in place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from facts_damping_msgs.msg import PmuDataFrame, PmuFrame, VoltageSetpoint, VoltageSetpoints
from rclpy.serialization import deserialize_message

from facts_damping.loop import controller_names
from facts_damping.nodes.cdr import Template, views
from facts_damping.signals import CHANNELS, DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Hashable

    from builtin_interfaces.msg import Time
    from numpy.typing import NDArray

    from facts_damping.configuration import Case

MOST_SHAPES = 64  # of one topic; when there are more, all are laid out anew as they come


class Shape:
    """A message of one shape: a table of entries under a header, a tick and `fresh`.

    `times` and `numbers` say which fields of an entry hold which fields of a row: row field -> path, or
    paths.
    """

    def __init__(self, message: Any, entries: str, times: dict[str, Any], numbers: dict[str, Any]) -> None:
        """Lay the message out."""
        self.count = len(getattr(message, entries))
        message.fresh = self.count > 0
        self.template = t = Template(message)

        def of_entries(*paths: str) -> Any:
            return t.index(f"{entries}.{i}.{path}" for i in range(self.count) for path in paths)

        self.stamp, self.nanosec = t.index(["header.stamp.sec"]), t.index(["header.stamp.nanosec"])
        self.tick = t.index(["tick"])
        self.times, self.numbers = {}, {}
        if self.count:
            for name, path in times.items():
                self.times[name] = (of_entries(f"{path}.sec"), of_entries(f"{path}.nanosec"))
            for name, path in numbers.items():
                self.numbers[name] = of_entries(*([path] if isinstance(path, str) else path))

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], more: dict[str, Any]) -> bytes:
        """The message of `rows`; `more` holds numbers that rows do not."""
        t = self.template
        t.write(self.stamp, start_ns // NANOSECONDS)
        t.write(self.nanosec, start_ns % NANOSECONDS)
        t.write(self.tick, tick)
        for name, (sec, nanosec) in self.times.items():
            t.write(sec, rows[name] // NANOSECONDS)
            t.write(nanosec, rows[name] % NANOSECONDS)
        for name, field in self.numbers.items():
            t.write(field, (more[name] if name in more else rows[name]).reshape(-1))
        return t.data()

    def read(self, data: bytes, rows: NDArray[Any]) -> int:
        """Fill `rows` from a message that fits; returns its tick."""
        seen = views(data)
        tick = int(seen["u8"][self.tick[1]][0])
        rows["tick"] = tick
        for name, (sec, nanosec) in self.times.items():
            rows[name] = seen["i4"][sec[1]].astype(np.int64) * NANOSECONDS + seen["u4"][nanosec[1]]
        for name, field in self.numbers.items():
            if name in (rows.dtype.names or ()) and name != "tick":
                rows[name] = seen[field[0]][field[1]].reshape(rows[name].shape)
        return tick


class Table:
    """Messages of one type in all the shapes that have come up, by key: the names of a message's entries."""

    entries: ClassVar[str]
    times: ClassVar[dict[str, Any]]
    numbers: ClassVar[dict[str, Any]]

    def __init__(self) -> None:
        self._shapes: dict[Hashable, Shape] = {}

    def make(self, key: Any) -> Any:
        """An empty message of the shape that `key` stands for."""
        raise NotImplementedError

    def shape(self, key: Hashable) -> Shape:
        """The shape of a key."""
        if key not in self._shapes:
            if len(self._shapes) >= MOST_SHAPES:
                self._shapes.clear()
            self._shapes[key] = Shape(self.make(key), self.entries, self.times, self.numbers)
        return self._shapes[key]

    def fitting(self, data: bytes) -> Hashable | None:
        """Key of the shape that a message has; None where no such message has come up."""
        for key, shape in self._shapes.items():
            if shape.template.fits(data):
                return key
        return None


class Frames(Table):
    """PMU data frames of a case; a key is the stations of the entries, in order."""

    entries: ClassVar[str] = "frames"
    times: ClassVar[dict[str, Any]] = {"measured_ns": "header.stamp", "arrival_ns": "arrival"}
    numbers: ClassVar[dict[str, Any]] = {
        "values": [f"{name}_{unit}" for name, unit in CHANNELS.items()],
        "tick": "tick",
        "status": "status",
    }

    def __init__(self, case: Case) -> None:
        """Take the names of stations and their buses."""
        super().__init__()
        self._stations = [station.name for station in case.system.stations]
        buses = {m.name: m.bus for m in case.system.machines}
        self._buses = [s.bus or buses[s.machine or ""] for s in case.system.stations]
        self._frame_rate = case.run.frame_rate

    def make(self, key: tuple[int, ...]) -> PmuDataFrame:
        """A message with an entry for each station of the key."""
        message = PmuDataFrame(frames=[PmuFrame(station=self._stations[station]) for station in key])
        for entry, station in zip(message.frames, key, strict=True):
            entry.header.frame_id = self._buses[station]
        return message

    def fill(self, tick: int, start_ns: int, delivered: NDArray[Any], count: int) -> bytes:
        """Message of `count` delivered entries."""
        rows = delivered[:count]
        sound = np.isfinite(rows["values"][:, [0, 1, 3, 4]]).all(axis=1)
        more = {
            "tick": -(-rows["measured_ns"] * self._frame_rate // NANOSECONDS),
            "status": np.where(sound, 0, PmuFrame.STATUS_DATA_ERROR),
        }
        return self.shape(tuple(rows["station"].tolist())).fill(tick, start_ns, rows, more)

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and entries (DELIVERY) of a message; an entry of an unknown station is passed over."""
        key = self.fitting(data)
        if key is None:
            message = deserialize_message(data, PmuDataFrame)
            known = [entry for entry in message.frames if entry.station in self._stations]
            key = tuple(self._stations.index(entry.station) for entry in known)
            if not self.shape(key).template.fits(data):
                return message.tick, self._read_slowly(message.tick, known)
        shape = self._shapes[key]
        rows = np.zeros(shape.count, DELIVERY)
        rows["station"] = key
        return shape.read(data, rows), rows

    def _read_slowly(self, tick: int, entries: list[PmuFrame]) -> NDArray[Any]:
        rows = [
            (
                tick,
                self._stations.index(entry.station),
                _time_ns(entry.header.stamp),
                _time_ns(entry.arrival),
                tuple(getattr(entry, name) for name in self.numbers["values"]),
            )
            for entry in entries
        ]
        return np.array(rows, DELIVERY)


class Setpoints(Table):
    """Voltage setpoints of a case; a key is the message's controller, and controller and device of each entry."""

    entries: ClassVar[str] = "setpoints"
    times: ClassVar[dict[str, Any]] = {
        "measured_ns": "header.stamp",
        "issued_ns": "issued",
        "effective_ns": "effective",
    }
    numbers: ClassVar[dict[str, Any]] = {"value": "value_pu"}

    def __init__(self, case: Case) -> None:
        """Take the names of devices and controllers."""
        super().__init__()
        self._devices = list(case.run.devices)
        self._places = {d.name: f"{d.from_bus}-{d.to_bus}" for d in case.system.devices}
        self._controllers = controller_names(case)

    def make(self, key: tuple[str, tuple[tuple[int, int], ...]]) -> VoltageSetpoints:
        """A message with an entry for each pair of controller and device of the key."""
        controller, pairs = key
        message = VoltageSetpoints(controller=controller)
        for c, d in pairs:
            entry = VoltageSetpoint(device=self._devices[d], controller=self._controllers[c])
            entry.header.frame_id = self._places[entry.device]
            message.setpoints.append(entry)
        return message

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], controller: str) -> bytes:
        """Message of setpoints; `controller` is empty as delivered by a link."""
        pairs = tuple(zip(rows["controller"].tolist(), rows["device"].tolist(), strict=True))
        return self.shape((controller, pairs)).fill(tick, start_ns, rows, {})

    def read(self, data: bytes) -> tuple[int, str, NDArray[Any]]:
        """Tick, controller and setpoints (SETPOINT) of a message; those of unknown names are passed over."""
        key: Any = self.fitting(data)
        if key is None:
            message = deserialize_message(data, VoltageSetpoints)
            known = [e for e in message.setpoints if e.device in self._devices and e.controller in self._controllers]
            pairs = tuple((self._controllers.index(e.controller), self._devices.index(e.device)) for e in known)
            key = (message.controller, pairs)
            if not self.shape(key).template.fits(data):
                return message.tick, message.controller, self._read_slowly(message.tick, pairs, known)
        shape = self._shapes[key]
        rows = np.zeros(shape.count, SETPOINT)
        for i, (controller, device) in enumerate(key[1]):
            rows["controller"][i], rows["device"][i] = controller, device
        return shape.read(data, rows), key[0], rows

    def _read_slowly(
        self, tick: int, pairs: tuple[tuple[int, int], ...], entries: list[VoltageSetpoint]
    ) -> NDArray[Any]:
        rows = [
            (tick, *pair, _time_ns(e.header.stamp), _time_ns(e.issued), _time_ns(e.effective), e.value_pu)
            for pair, e in zip(pairs, entries, strict=True)
        ]
        return np.array(rows, SETPOINT)


def _time_ns(time: Time) -> int:
    """A time message as integer nanoseconds."""
    return int(time.sec * NANOSECONDS + time.nanosec)
