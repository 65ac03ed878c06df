"""What goes over the wire every tick: frames and setpoints, between arrays and bytes, bit for bit.

A message with a table of entries has a shape (whose entries, in which order); each shape that comes up
is laid out once (`cdr.Template`) and then written and read in place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from facts_damping_msgs.msg import PmuDataFrame, PmuFrame, VoltageSetpoint, VoltageSetpoints
from rclpy.serialization import deserialize_message

from facts_damping.case.names import controller_names
from facts_damping.compiling import specialised
from facts_damping.nodes.cdr import Template
from facts_damping.nodes.packing import mark, pack, unpack
from facts_damping.signals import CHANNELS, DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Hashable

    from builtin_interfaces.msg import Time
    from numpy.typing import NDArray

    from facts_damping.case.model import Case

TIMES_AND_VALUES, MARKS = ("i4", "u4", "i8"), ("u8", "u2")  # formats, as the kernels want them
MOST_SHAPES = 64  # of one topic; when there are more, all are laid out anew as they come


class Layout(NamedTuple):
    """How a message's table of entries lies in rows of eight-byte words (DELIVERY, SETPOINT).

    `times`: paths of an entry's times, in the order of the row's columns from `first` on; `values`: paths of its
    numbers, in the order of the columns after them; `marks`: paths of what follows from these, and is not read.
    """

    entries: str
    dtype: np.dtype[Any]
    first: int
    times: list[str]
    values: list[str]
    marks: list[str]


class Shape:
    """A message of one shape: a table of entries under a header, a tick and `fresh`."""

    def __init__(self, message: Any, layout: Layout, names: dict[str, Any]) -> None:
        """Lay the message out; `names`: the columns of its rows that say whose entries they are."""
        self._layout = layout
        entries = getattr(message, layout.entries)
        message.fresh = len(entries) > 0
        self._rows = np.zeros(len(entries), layout.dtype)
        for column, values in names.items():
            self._rows[column] = values
        self.template = t = Template(message)
        parts = [f"{path}.{part}" for path in layout.times for part in ("sec", "nanosec")]
        self._columns = layout.first, len(layout.times), self._of_entries([*parts, *layout.values])
        self.marks = self._of_entries(layout.marks)
        self._sent, self._come = ([room.of[form] for form in TIMES_AND_VALUES] for room in (t.sent, t.come))
        self._pack = specialised(pack, self._words(self._rows), *self._columns, *self._sent)
        self._unpack = specialised(unpack, self._words(self._rows), *self._columns, *self._come)

    def _of_entries(self, paths: list[str]) -> NDArray[np.int64]:
        """Places of fields, (entries, paths)."""
        places = np.zeros((len(self._rows), len(paths)), np.int64)
        for (i, j), _ in np.ndenumerate(places):
            places[i, j] = self.template.index([f"{self._layout.entries}.{i}.{paths[j]}"]).places[0]
        return places

    def _words(self, rows: NDArray[Any]) -> NDArray[np.int64]:
        return rows.view(np.int64).reshape(len(self._rows), self._layout.dtype.itemsize // 8)

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any]) -> bytes:
        """The message of `rows`."""
        self._pack(self._words(rows), *self._columns, *self._sent)
        self.template.write_head(start_ns, tick)
        return self.template.data()

    def read(self) -> tuple[int, NDArray[Any]]:
        """Tick and rows of the message that was taken."""
        tick, rows = self.template.tick(), self._rows.copy()
        rows["tick"] = tick
        self._unpack(self._words(rows), *self._columns, *self._come)
        return tick, rows


class TableMessage:
    """Messages of one type in all the shapes that have come up, by key: the names of a message's entries."""

    layout: ClassVar[Layout]

    def __init__(self) -> None:
        self._shapes: dict[Hashable, Shape] = {}

    def make(self, key: Any) -> tuple[Any, dict[str, Any]]:
        """An empty message of the shape that `key` stands for, and the columns of its rows that say whose they are."""
        raise NotImplementedError

    def shape(self, key: Hashable) -> Shape:
        """The shape of a key."""
        if key not in self._shapes:
            if len(self._shapes) >= MOST_SHAPES:
                self._shapes.clear()
            message, names = self.make(key)
            self._shapes[key] = Shape(message, self.layout, names)
        return self._shapes[key]

    def taking(self, data: bytes) -> Hashable | None:
        """Key of the shape that takes a message; None where no such message has come up."""
        for key, shape in self._shapes.items():
            if shape.template.take(data):
                return key
        return None


class FramesMessage(TableMessage):
    """PMU data frames of a case; a key is the stations of the entries, in order."""

    layout = Layout(
        "frames",
        DELIVERY,
        first=3,
        times=["header.stamp", "arrival"],
        values=[f"{name}_{unit}" for name, unit in CHANNELS.items()],
        marks=["tick", "status"],
    )

    def __init__(self, case: Case) -> None:
        """Take the names of stations and their buses."""
        super().__init__()
        self._stations = [station.name for station in case.system.stations]
        buses = {m.name: m.bus for m in case.system.machines}
        self._buses = [s.bus or buses[s.machine or ""] for s in case.system.stations]
        self._marks = case.run.frame_rate, int(PmuFrame.STATUS_DATA_ERROR)
        numbers = [np.zeros(0, f"<{form}") for form in MARKS]
        self._mark = specialised(mark, np.zeros(0, DELIVERY), *self._marks, np.zeros((0, 2), np.int64), *numbers)

    def make(self, key: tuple[int, ...]) -> tuple[PmuDataFrame, dict[str, Any]]:
        """A message with an entry for each station of the key."""
        message = PmuDataFrame(frames=[PmuFrame(station=self._stations[station]) for station in key])
        for entry, station in zip(message.frames, key, strict=True):
            entry.header.frame_id = self._buses[station]
        return message, {"station": key}

    def fill(self, tick: int, start_ns: int, delivered: NDArray[Any], count: int) -> bytes:
        """Message of `count` delivered entries."""
        rows = delivered[:count]
        shape = self.shape(tuple(rows["station"].tolist()))
        self._mark(rows, *self._marks, shape.marks, *(shape.template.sent.of[form] for form in MARKS))
        return shape.fill(tick, start_ns, rows)

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and entries (DELIVERY, no link) of a message; an entry of an unknown station is passed over."""
        key = self.taking(data)
        if key is None:
            message = deserialize_message(data, PmuDataFrame)
            known = [entry for entry in message.frames if entry.station in self._stations]
            key = tuple(self._stations.index(entry.station) for entry in known)
            if not self.shape(key).template.take(data):
                return message.tick, self._read_slowly(message.tick, known)
        return self._shapes[key].read()

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


class SetpointsMessage(TableMessage):
    """Voltage setpoints of a case; a key is the message's controller, and controller and device of each entry."""

    layout = Layout(
        "setpoints",
        SETPOINT,
        first=3,
        times=["header.stamp", "issued", "effective"],
        values=["value_pu"],
        marks=[],
    )

    def __init__(self, case: Case) -> None:
        """Take the names of devices and controllers."""
        super().__init__()
        self._devices = list(case.run.devices)
        self._places = {d.name: d.place for d in case.system.devices}
        self._controllers = controller_names(case)

    def make(self, key: tuple[str, tuple[tuple[int, int], ...]]) -> tuple[VoltageSetpoints, dict[str, Any]]:
        """A message with an entry for each pair of controller and device of the key."""
        controller, pairs = key
        message = VoltageSetpoints(controller=controller)
        for c, d in pairs:
            entry = VoltageSetpoint(device=self._devices[d], controller=self._controllers[c])
            entry.header.frame_id = self._places[entry.device]
            message.setpoints.append(entry)
        return message, {"controller": [c for c, _ in pairs], "device": [d for _, d in pairs]}

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], controller: str) -> bytes:
        """Message of setpoints; `controller` is empty as delivered by a link."""
        pairs = tuple(zip(rows["controller"].tolist(), rows["device"].tolist(), strict=True))
        return self.shape((controller, pairs)).fill(tick, start_ns, rows)

    def read(self, data: bytes) -> tuple[int, str, NDArray[Any]]:
        """Tick, controller and setpoints (SETPOINT) of a message; those of unknown names are passed over."""
        key: Any = self.taking(data)
        if key is None:
            message = deserialize_message(data, VoltageSetpoints)
            known = [e for e in message.setpoints if e.device in self._devices and e.controller in self._controllers]
            pairs = tuple((self._controllers.index(e.controller), self._devices.index(e.device)) for e in known)
            key = (message.controller, pairs)
            if not self.shape(key).template.take(data):
                return message.tick, message.controller, self._read_slowly(message.tick, pairs, known)
        tick, rows = self._shapes[key].read()
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
