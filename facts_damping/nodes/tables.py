"""What goes over the wire every tick: frames and setpoints, between arrays and bytes, bit for bit.

A message with a table of entries has a shape (whose entries, in which order); each shape that comes up
is laid out once (`cdr.Template`) and then written and read in place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from facts_damping_msgs.msg import PmuDataFrame, PmuFrame, VoltageSetpoint, VoltageSetpoints
from rclpy.serialization import deserialize_message

from facts_damping.nodes.cdr import Field, Template, read
from facts_damping.parts import controller_names
from facts_damping.signals import CHANNELS, DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Hashable, Sequence

    from builtin_interfaces.msg import Time
    from numpy.typing import NDArray

    from facts_damping.configuration import Case

MOST_SHAPES = 64  # of one topic; when there are more, all are laid out anew as they come


class Layout(NamedTuple):
    """How a message's table of entries lies in rows of eight-byte words (DELIVERY, SETPOINT).

    `times`: paths of an entry's times, in the order of the row's columns from `first_time` on;
    `values`: paths of its numbers, in the order of the columns from `first_value` on.
    """

    entries: str
    dtype: np.dtype[Any]
    times: list[str]
    first_time: int
    values: list[str]
    first_value: int


class Shape:
    """A message of one shape: a table of entries under a header, a tick and `fresh`."""

    def __init__(self, message: Any, layout: Layout) -> None:
        """Lay the message out."""
        self.count = len(getattr(message, layout.entries))
        message.fresh = self.count > 0
        self.template = Template(message)
        self._layout = layout
        self._fields: dict[tuple[str, ...], Field] = {}
        self._times = slice(layout.first_time, layout.first_time + len(layout.times))
        self._values = slice(layout.first_value, layout.first_value + len(layout.values))
        self._sec = self.of_entries(*(f"{path}.sec" for path in layout.times))
        self._nanosec = self.of_entries(*(f"{path}.nanosec" for path in layout.times))
        self._numbers = self.of_entries(*layout.values)

    def of_entries(self, *paths: str) -> Field:
        """Fields of all entries, entry by entry."""
        if paths not in self._fields:
            places = (f"{self._layout.entries}.{i}.{path}" for i in range(self.count) for path in paths)
            self._fields[paths] = self.template.index(places)
        return self._fields[paths]

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], more: Sequence[tuple[Field, Any]] = ()) -> bytes:
        """The message of `rows`; `more` gives fields that rows do not hold, and their values."""
        t = self.template
        t.write_head(start_ns, tick)
        if self.count:
            words = rows.view(np.int64).reshape(self.count, -1)
            sec, nanosec = np.divmod(words[:, self._times], NANOSECONDS)
            t.write(self._sec, sec.ravel())
            t.write(self._nanosec, nanosec.ravel())
            t.write(self._numbers, words.view(np.float64)[:, self._values].ravel())
            for field, values in more:
                t.write(field, values)
        return t.data()

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and rows of a message that fits; names are the caller's to fill in."""
        rows = np.zeros(self.count, self._layout.dtype)
        tick = self.template.tick_of(data)
        rows["tick"] = tick
        if self.count:
            words = rows.view(np.int64).reshape(self.count, -1)
            times = read(data, self._sec).astype(np.int64) * NANOSECONDS + read(data, self._nanosec)
            words[:, self._times] = times.reshape(self.count, -1)
            words.view(np.float64)[:, self._values] = read(data, self._numbers).reshape(self.count, -1)
        return tick, rows


class Table:
    """Messages of one type in all the shapes that have come up, by key: the names of a message's entries."""

    layout: ClassVar[Layout]

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
            self._shapes[key] = Shape(self.make(key), self.layout)
        return self._shapes[key]

    def fitting(self, data: bytes) -> Hashable | None:
        """Key of the shape that a message has; None where no such message has come up."""
        for key, shape in self._shapes.items():
            if shape.template.fits(data):
                return key
        return None


class Frames(Table):
    """PMU data frames of a case; a key is the stations of the entries, in order."""

    layout = Layout(
        "frames",
        DELIVERY,
        times=["header.stamp", "arrival"],
        first_time=3,
        values=[f"{name}_{unit}" for name, unit in CHANNELS.items()],
        first_value=5,
    )

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
        shape = self.shape(tuple(rows["station"].tolist()))
        if not count:
            return shape.fill(tick, start_ns, rows)
        sound = np.isfinite(rows["values"][:, [0, 1, 3, 4]]).all(axis=1)
        ticks = -(-rows["measured_ns"] * self._frame_rate // NANOSECONDS)
        status = np.where(sound, 0, PmuFrame.STATUS_DATA_ERROR)
        return shape.fill(
            tick, start_ns, rows, [(shape.of_entries("tick"), ticks), (shape.of_entries("status"), status)]
        )

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and entries (DELIVERY, no link) of a message; an entry of an unknown station is passed over."""
        key = self.fitting(data)
        if key is None:
            message = deserialize_message(data, PmuDataFrame)
            known = [entry for entry in message.frames if entry.station in self._stations]
            key = tuple(self._stations.index(entry.station) for entry in known)
            if not self.shape(key).template.fits(data):
                return message.tick, self._read_slowly(message.tick, known)
        tick, rows = self._shapes[key].read(data)
        rows["station"] = key
        return tick, rows

    def _read_slowly(self, tick: int, entries: list[PmuFrame]) -> NDArray[Any]:
        rows = [
            (
                tick,
                self._stations.index(entry.station),
                0,
                time_ns(entry.header.stamp),
                time_ns(entry.arrival),
                tuple(getattr(entry, name) for name in self.layout.values),
            )
            for entry in entries
        ]
        return np.array(rows, DELIVERY)


class Setpoints(Table):
    """Voltage setpoints of a case; a key is the message's controller, and controller and device of each entry."""

    layout = Layout(
        "setpoints",
        SETPOINT,
        times=["header.stamp", "issued", "effective"],
        first_time=3,
        values=["value_pu"],
        first_value=6,
    )

    def __init__(self, case: Case) -> None:
        """Take the names of devices and controllers."""
        super().__init__()
        self._devices = list(case.run.devices)
        self._places = {d.name: d.place for d in case.system.devices}
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
        return self.shape((controller, pairs)).fill(tick, start_ns, rows)

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
        tick, rows = self._shapes[key].read(data)
        if key[1]:
            rows["controller"], rows["device"] = zip(*key[1], strict=True)
        return tick, key[0], rows

    def _read_slowly(
        self, tick: int, pairs: tuple[tuple[int, int], ...], entries: list[VoltageSetpoint]
    ) -> NDArray[Any]:
        rows = [
            (tick, *pair, time_ns(e.header.stamp), time_ns(e.issued), time_ns(e.effective), e.value_pu)
            for pair, e in zip(pairs, entries, strict=True)
        ]
        return np.array(rows, SETPOINT)


def time_ns(time: Time) -> int:
    """A time message as integer nanoseconds."""
    return int(time.sec * NANOSECONDS + time.nanosec)
