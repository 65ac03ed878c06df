"""Messages of every tick, frames and setpoints: exact conversion between arrays and bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.names import controller_names, supervisor_names
from facts_damping.nodes.transport import packing, stamps
from facts_damping.nodes.transport.cdr import LONGEST, Refused
from facts_damping.nodes.transport.signing import LENGTH
from facts_damping.recording.columns import HEADER
from facts_damping.signals import DELIVERY, SETPOINT, start_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.nodes.transport.signing import Seal

ENCAPSULATION = b"\0\1\0\0"  # plain CDR, little-endian
SHORTEST = 40  # lower limit of an entry's bytes
LONGEST_ENTRY = 1 << 10  # upper limit of an entry's bytes without its names
EMPTY, SENDERS, DEVICES, CONTROLLERS, PMUS, PLACES = range(6)  # tables of names
FIRST_STEPS = [
    (packing.TIME, packing.START, 0),
    (packing.FREE, packing.NOTHING, EMPTY),
    (packing.NUMBER, packing.TICK, 0),
]
LAST_STEPS = [(packing.FLAG, packing.FRESH, 0), (packing.COUNT, packing.ENTRIES, 0)]


class TableMessage:
    """Messages of one type: header, tick, optional sender, `fresh`, and a table of entries."""

    def __init__(
        self,
        dtype: np.dtype[Any],
        head: Sequence[tuple[int, int, int]],
        entry: Sequence[tuple[int, int, int]],
        names: dict[int, list[str]],
        frame_rate: int,
        seal: Seal | None,
    ) -> None:
        """`dtype`: of the rows; `head`, `entry`: steps (packing.py); `names`: by table; `seal`: None if not signed."""
        self._dtype, self._rate, self._seal = dtype, frame_rate, seal
        texts = [[name.encode() + b"\0" for name in names.get(table, [""])] for table in range(PLACES + 1)]
        many, longest = max(map(len, texts)), max(len(text) for table in texts for text in table)
        table = np.array([[text.ljust(longest, b"\0") for text in row + [b""] * (many - len(row))] for row in texts])
        lengths = np.array([[len(text) for text in row] + [0] * (many - len(row)) for row in texts], np.int64)
        octets = np.frombuffer(table.tobytes(), np.uint8).reshape(*lengths.shape, longest).copy()
        self._plan = packing.PackingPlan(
            np.array(head, np.int64), np.array(entry, np.int64), octets, lengths, frame_rate
        )
        self._entry = LONGEST_ENTRY + longest * len(entry)
        self._head = np.zeros(packing.NOTHING + 1, np.int64)
        self._make_room(4 * self._entry)

    def _make_room(self, size: int) -> None:
        """Allocate room for messages of `size` bytes; the stream is aligned to eight bytes."""
        self._room = -(-size // 8) * 8
        words = np.zeros(1 + self._room // 8, np.int64)  # the stream begins with the second word
        self._all, stream = words.view(np.uint8)[HEADER:], words[1:]
        self._all[:HEADER] = np.frombuffer(ENCAPSULATION, np.uint8)
        forms = stream.view(np.uint16), stream.view(np.int32), stream.view(np.uint32), stream
        self._stream = packing.Stream(stream.view(np.uint8), *forms)

    def write(self, tick: int, start_ns: int, rows: NDArray[Any], sender: int = 0) -> bytes:
        """Message of `rows`, signed if there is a seal; `sender`: index in the table SENDERS."""
        if (size := (len(rows) + 2) * self._entry) > self._room:
            self._make_room(2 * size)
        head = self._head
        head[:] = start_ns, 0, sender, len(rows) > 0, len(rows), LENGTH if self._seal else 0, 0, 0, 0
        head.view(np.uint64)[packing.TICK] = tick
        words = rows.view(np.int64).reshape(len(rows), self._dtype.itemsize // 8)
        end = HEADER + packing.write(self._plan, self._stream, head, words, stamps.epoch_ns())
        body = self._all[:end].tobytes()
        return body if self._seal is None else body + self._seal.sign(body)

    def read(self, data: bytes) -> tuple[int, NDArray[Any]]:
        """Tick and rows of a message. Raises `Refused` for a wrong length, format, name, signature or stamp."""
        head, size = self._head, len(data) - HEADER
        if len(data) > LONGEST:
            raise Refused("length")
        if data[:2] != ENCAPSULATION[:2] or size < 0:
            raise Refused("format")
        if size > self._room:
            self._make_room(2 * size)
        self._stream.octets[:size] = np.frombuffer(data, np.uint8)[HEADER:]
        epoch, rows = stamps.epoch_ns(), self._rows(size)
        count = self._read(size, rows)
        body, signature = data[: HEADER + head[packing.BEGIN]], data[HEADER + head[packing.BEGIN] :]
        if head[packing.SIGNATURE] != (LENGTH if self._seal else 0):
            raise Refused("signature")
        tick = int(head.view(np.uint64)[packing.TICK])
        start_ns = start_of(tick, self._rate)
        if self._seal is not None:
            self._seal.check(body, signature[:LENGTH], start_ns)
        if not stamps.accept(int(head[packing.START]), start_ns):
            raise Refused("stamp")
        if stamps.epoch_ns() != epoch:  # the epoch came with this message: read the times again
            self._read(size, rows)
        if head[packing.LATEST] >= start_of(tick + 1, self._rate):
            raise Refused("stamp")
        rows = rows[:count].copy()
        rows["tick"] = tick
        return tick, rows

    def _rows(self, size: int) -> NDArray[Any]:
        """Zeroed rows, enough for the entries of a message of `size` bytes."""
        return np.zeros(size // SHORTEST + 1, self._dtype)

    def _read(self, size: int, rows: NDArray[Any]) -> int:
        """Read the stream into `rows`. Returns the number of entries; raises `Refused` for a wrong format or name."""
        words = rows.view(np.int64).reshape(len(rows), self._dtype.itemsize // 8)
        count = packing.read(self._plan, self._stream, size, self._head, words, stamps.epoch_ns())
        if count < 0:
            raise Refused("names" if count == packing.NAMES else "format")
        return int(count)


def column(dtype: np.dtype[Any], name: str) -> int:
    """Index of a field's first word in a row."""
    return int(dict(dtype.fields or {})[name][1]) // 8


class FramesMessage(TableMessage):
    """PMU data frames of a case."""

    def __init__(self, case: Case, seal: Seal | None = None) -> None:
        """`seal`: of the topic, if messages are signed."""
        where = case.system.pmu_buses()
        pmu, measured = column(DELIVERY, "pmu"), column(DELIVERY, "measured_ns")
        values = range(column(DELIVERY, "values"), DELIVERY.itemsize // 8)
        entry = [
            (packing.TIME, measured, 0),
            (packing.LABEL, pmu, PLACES),
            (packing.NAME, pmu, PMUS),
            (packing.NEAREST, measured, 0),
            (packing.TIME, column(DELIVERY, "arrival_ns"), 0),
            *((packing.NUMBER, value, 0) for value in values),
            (packing.STATUS, column(DELIVERY, "status"), 0),
        ]
        names = {PMUS: list(where), PLACES: list(where.values())}
        super().__init__(DELIVERY, FIRST_STEPS + LAST_STEPS, entry, names, case.run.frame_rate, seal)

    def fill(self, tick: int, start_ns: int, delivered: NDArray[Any], count: int) -> bytes:
        """Message of `count` delivered entries."""
        return self.write(tick, start_ns, delivered[:count])


class SetpointsMessage(TableMessage):
    """Voltage setpoints of a case.

    The `frame_id` of an entry is only for readers: it is not checked, and a user's own node may leave it empty.
    """

    def __init__(self, case: Case, sender: str = "", of: Iterable[int] | None = None, seal: Seal | None = None) -> None:
        """`seal`: of the topic, if messages are signed.

        `read` accepts only messages of `sender` (a controller; empty: a link) with setpoints of the controllers `of`
        (None: all).
        """
        devices, controllers = list(case.run.devices), controller_names(case)
        self._senders = list(dict.fromkeys([sender, "", *controllers, *supervisor_names(case).values()]))
        self._allowed = np.zeros((len(controllers), len(devices)), np.bool_)
        for c in range(len(controllers)) if of is None else of:
            self._allowed[c, [devices.index(name) for name in case.controllers[c].devices]] = True
        device, controller = column(SETPOINT, "device"), column(SETPOINT, "controller")
        entry = [
            (packing.TIME, column(SETPOINT, "measured_ns"), 0),
            (packing.FREE, device, PLACES),
            (packing.NAME, device, DEVICES),
            (packing.NAME, controller, CONTROLLERS),
            (packing.TIME, column(SETPOINT, "issued_ns"), 0),
            (packing.TIME, column(SETPOINT, "effective_ns"), 0),
            (packing.NUMBER, column(SETPOINT, "value"), 0),
        ]
        places = [case.system.device(name).place for name in devices]
        names = {SENDERS: self._senders, DEVICES: devices, CONTROLLERS: controllers, PLACES: places}
        head = [*FIRST_STEPS, (packing.NAME, packing.SENDER, SENDERS), *LAST_STEPS]
        super().__init__(SETPOINT, head, entry, names, case.run.frame_rate, seal)

    def _read(self, size: int, rows: NDArray[Any]) -> int:
        count = super()._read(size, rows)
        read = rows[:count]
        if self._head[packing.SENDER] != 0 or not self._allowed[read["controller"], read["device"]].all():
            raise Refused("names")
        return count

    def fill(self, tick: int, start_ns: int, rows: NDArray[Any], controller: str) -> bytes:
        """Message of setpoints; `controller`: name of the sender, empty for a link."""
        return self.write(tick, start_ns, rows, self._senders.index(controller))
