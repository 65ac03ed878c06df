"""What goes over the wire every tick: frames and setpoints, between arrays and bytes, bit for bit.

A message with a table of entries has a shape (whose entries, in which order); each shape that comes up
is laid out once (`cdr.Template`) and then written and read in place.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from facts_damping_msgs.msg import PmuDataFrame, PmuFrame, VoltageSetpoint, VoltageSetpoints

from facts_damping.case.names import controller_names
from facts_damping.nodes import stamps
from facts_damping.nodes.cdr import Refused, Template, content
from facts_damping.nodes.packing import mark, pack, unpack
from facts_damping.nodes.signing import LENGTH
from facts_damping.recording.columns import HEADER
from facts_damping.signals import CHANNELS, DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable
    from types import SimpleNamespace

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.nodes.signing import Seal

TIMES_AND_VALUES, MARKS = ("i4", "u4", "i8"), ("u8", "u2")  # formats, as the kernels want them
MOST_SHAPES = 64  # of one topic; when there are more, all are laid out anew as they come


class Layout(NamedTuple):
    """How a message's table of entries lies in rows of eight-byte words (DELIVERY, SETPOINT).

    `times`: paths of an entry's times, in the order of the row's columns from `first` on; `values`: paths of its
    numbers, in the order of the columns after them; `marks`: paths of what is written beside; of these `bits`, a
    column and its path, is read.
    """

    entries: str
    dtype: np.dtype[Any]
    first: int
    times: list[str]
    values: list[str]
    marks: list[str]
    bits: tuple[str, str] | None = None


class Shape:
    """A message of one shape: a table of entries under a header, a tick and `fresh`."""

    def __init__(
        self, message: Any, layout: Layout, names: dict[str, Any], frame_rate: int, seal: Seal | None = None
    ) -> None:
        """Lay the message out; `names`: the columns of its rows that say whose entries they are."""
        self._layout, self._rate, self._seal = layout, frame_rate, seal
        message.signature = bytes(LENGTH if seal else 0)
        entries = getattr(message, layout.entries)
        message.fresh = len(entries) > 0
        self._rows = np.zeros(len(entries), layout.dtype)
        for column, values in names.items():
            self._rows[column] = values
        self.template = t = Template(message)
        self._end = HEADER + int(t.index(["signature.0"]).places[0]) if seal else 0  # where the signature begins
        parts = [f"{path}.{part}" for path in layout.times for part in ("sec", "nanosec")]
        self._columns = layout.first, len(layout.times), self._of_entries([*parts, *layout.values])
        self.marks = self._of_entries(layout.marks)
        self._bits = None if layout.bits is None else t.index(self._paths(layout.bits[1]))
        self._sent, self._come = ([room.of[form] for form in TIMES_AND_VALUES] for room in (t.sent, t.come))

    def _of_entries(self, paths: list[str]) -> NDArray[np.int64]:
        """Places of fields, (entries, paths)."""
        places = np.zeros((len(self._rows), len(paths)), np.int64)
        for (i, j), _ in np.ndenumerate(places):
            places[i, j] = self.template.index([f"{self._layout.entries}.{i}.{paths[j]}"]).places[0]
        return places

    def _paths(self, path: str) -> list[str]:
        return [f"{self._layout.entries}.{i}.{path}" for i in range(len(self._rows))]

    def _words(self, rows: NDArray[Any]) -> NDArray[np.int64]:
        return rows.view(np.int64).reshape(len(self._rows), self._layout.dtype.itemsize // 8)

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any]) -> bytes:
        """The message of `rows`."""
        pack(self._words(rows), *self._columns, *self._sent, stamps.epoch_ns())
        self.template.write_head(start_ns, tick)
        data = self.template.data()
        if self._seal is None:
            return data
        body = data[: self._end]
        return body + self._seal.sign(body) + data[self._end + LENGTH :]

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and rows of a message that was taken. Raises `Refused` where it is not signed, or not of its tick."""
        tick, rows = self.template.tick(), self._rows.copy()
        if self._seal is not None:
            self._seal.check(data[: self._end], data[self._end : self._end + LENGTH], start_of(tick, self._rate))
        if not stamps.accept(self.template.start_ns(), start_of(tick, self._rate)):
            raise Refused("stamp")
        taken = self._words(rows), *self._columns, *self._come, stamps.epoch_ns()
        if unpack(*taken) >= start_of(tick + 1, self._rate):
            raise Refused("stamp")
        rows["tick"] = tick
        if self._layout.bits is not None and self._bits is not None:
            rows[self._layout.bits[0]] = self.template.read(self._bits)
        return tick, rows


class TableMessage:
    """Messages of one type in all the shapes that have come up, by key: the names of a message's entries."""

    layout: ClassVar[Layout]

    def __init__(self, case: Case, seal: Seal | None) -> None:
        self._rate, self._seal = case.run.frame_rate, seal
        self._shapes: dict[Hashable, Shape] = {}

    def make(self, key: Any) -> tuple[Any, dict[str, Any]]:
        """An empty message of the shape that `key` stands for, and the columns of its rows that say whose they are."""
        raise NotImplementedError

    def key(self, data: bytes) -> Hashable:
        """Key of the shape that a message must have. Raises `Refused` where it is none, or of unknown names."""
        raise NotImplementedError

    def content(self, data: bytes, kind: type[Any]) -> SimpleNamespace:
        """What a message says. Raises `Refused` where it is none, and where it has no signature, or needs none."""
        message = content(data, kind)
        if len(message.signature) != (LENGTH if self._seal else 0):
            raise Refused("signature")
        return message

    def shape(self, key: Hashable) -> Shape:
        """The shape of a key."""
        if key not in self._shapes:
            if len(self._shapes) >= MOST_SHAPES:
                self._shapes.clear()
            message, names = self.make(key)
            self._shapes[key] = Shape(message, self.layout, names, self._rate, self._seal)
        return self._shapes[key]

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and rows of a message. Raises `Refused` where it is not what it should be."""
        for shape in self._shapes.values():
            if shape.template.take(data):
                return shape.read(data)
        shape = self.shape(self.key(data))
        if not shape.template.take(data):
            raise Refused("names")
        return shape.read(data)


class FramesMessage(TableMessage):
    """PMU data frames of a case; a key is the stations of the entries, in order."""

    layout = Layout(
        "frames",
        DELIVERY,
        first=4,
        times=["header.stamp", "arrival"],
        values=[f"{name}_{unit}" for name, unit in CHANNELS.items()],
        marks=["tick", "status"],
        bits=("status", "status"),
    )

    def __init__(self, case: Case, seal: Seal | None = None) -> None:
        """Take the names of stations and their buses; `seal`: of the topic, if messages are signed."""
        super().__init__(case, seal)
        where = case.system.station_buses()
        self._stations, self._buses = list(where), list(where.values())

    def make(self, key: tuple[int, ...]) -> tuple[PmuDataFrame, dict[str, Any]]:
        """A message with an entry for each station of the key."""
        message = PmuDataFrame(frames=[PmuFrame(station=self._stations[station]) for station in key])
        for entry, station in zip(message.frames, key, strict=True):
            entry.header.frame_id = self._buses[station]
        return message, {"station": key}

    def key(self, data: bytes) -> tuple[int, ...]:
        """Stations of a message's entries."""
        return places(self._stations, [entry.station for entry in self.content(data, PmuDataFrame).frames])

    def fill(self, tick: int, start_ns: int, delivered: NDArray[Any], count: int) -> bytes:
        """Message of `count` delivered entries."""
        rows = delivered[:count]
        shape = self.shape(tuple(rows["station"].tolist()))
        mark(rows, self._rate, shape.marks, *(shape.template.sent.of[form] for form in MARKS))
        return shape.fill(tick, start_ns, rows)


class SetpointsMessage(TableMessage):
    """Voltage setpoints of a case; a key is the message's controller, and controller, device and frame of each entry.

    A frame (`frame_id`) is for people: a node of the user's own may say another one, or none.
    """

    layout = Layout(
        "setpoints",
        SETPOINT,
        first=3,
        times=["header.stamp", "issued", "effective"],
        values=["value_pu"],
        marks=[],
    )

    def __init__(self, case: Case, sender: str = "", of: Iterable[int] | None = None, seal: Seal | None = None) -> None:
        """Take the names of devices and controllers; `seal`: of the topic, if messages are signed.

        What is read is from `sender` (a controller; empty: a link), with setpoints of these controllers; None: of all.
        """
        super().__init__(case, seal)
        self._devices = list(case.run.devices)
        self._frames = [case.system.device(name).place for name in self._devices]
        self._controllers = controller_names(case)
        self._sender = sender
        self._of = {
            c: {self._devices.index(name) for name in controller.devices}
            for c, controller in enumerate(case.controllers)
            if of is None or c in of
        }

    def make(self, key: tuple[str, tuple[tuple[int, int, str], ...]]) -> tuple[VoltageSetpoints, dict[str, Any]]:
        """A message with an entry for each controller, device and frame of the key."""
        controller, entries = key
        message = VoltageSetpoints(controller=controller)
        for c, d, frame in entries:
            entry = VoltageSetpoint(device=self._devices[d], controller=self._controllers[c])
            entry.header.frame_id = frame
            message.setpoints.append(entry)
        return message, {"controller": [c for c, *_ in entries], "device": [d for _, d, _ in entries]}

    def key(self, data: bytes) -> tuple[str, tuple[tuple[int, int, str], ...]]:
        """Sender of a message; controllers, devices and frames of its entries."""
        message = self.content(data, VoltageSetpoints)
        controllers = places(self._controllers, [entry.controller for entry in message.setpoints])
        devices = places(self._devices, [entry.device for entry in message.setpoints])
        frames = [str(entry.header.frame_id) for entry in message.setpoints]
        entries = tuple(zip(controllers, devices, frames, strict=True))
        if message.controller != self._sender or any(d not in self._of.get(c, ()) for c, d, _ in entries):
            raise Refused("names")
        return message.controller, entries

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], controller: str) -> bytes:
        """Message of setpoints; `controller` is empty as delivered by a link."""
        pairs = zip(rows["controller"].tolist(), rows["device"].tolist(), strict=True)
        entries = tuple((c, d, self._frames[d]) for c, d in pairs)
        return self.shape((controller, entries)).fill(tick, start_ns, rows)


def places(names: list[str], given: Iterable[str]) -> tuple[int, ...]:
    """Places of the given names among those that are allowed. Raises `Refused` for another one."""
    try:
        return tuple(map(names.index, given))
    except ValueError as error:
        raise Refused("names") from error


def start_of(tick: int, frame_rate: int) -> int:
    """Time of any tick whatever, ns: t_k = k / f, rounded down."""
    return tick * NANOSECONDS // frame_rate
