"""Messages as bytes: fields of a message whose shape stays are written and read in place.

rclpy converts a message field by field, object by object; for a frame of five stations that costs more
than the transport. Where names and lengths stay the same from tick to tick, so does the place of
every number in the CDR stream (little-endian, plain CDR as DDS-XTypes 1.3, 7.4.1 has it: a primitive is
aligned to its size). A `Template` knows these places and is published as raw bytes; a message that
does not fit it is read by rclpy as usual.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message

from facts_damping.compiling import specialised
from facts_damping.nodes.packing import take
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

HEADER = 4  # bytes of encapsulation before the stream
STRING, LENGTH = "string", "length"  # kinds of leaves that are not numbers
FORMATS = {
    "boolean": "u1",
    "uint8": "u1",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "double": "f8",
}
_SEQUENCE = re.compile(r"sequence<(.+)>")


def places(message: Any) -> tuple[dict[str, tuple[int, str]], list[int], int]:
    """Where things stand in the stream, after the encapsulation.

    Offset and format of every number, by path ("frames.0.tick"); offsets of all bytes that make out the
    shape: strings, their lengths, and those of sequences. What lies between is padding. At last the stream's end.
    """
    numbers: dict[str, tuple[int, str]] = {}
    shape: list[int] = []
    end = 0
    for path, kind, value in _fields(message, ""):
        size = 4 if kind in (STRING, LENGTH) else int(FORMATS[kind][1])
        start = -(-end // size) * size
        end = start + size + (len(value.encode()) + 1 if kind == STRING else 0)
        if kind in (STRING, LENGTH):
            shape += range(start, end)
        else:
            numbers[path] = (start, FORMATS[kind])
    return numbers, shape, end


def _fields(message: Any, prefix: str) -> Iterator[tuple[str, str, Any]]:
    """Path, type and value of every leaf of a message, in the order of the stream."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        sequence = _SEQUENCE.fullmatch(kind)
        if sequence:
            yield f"{prefix}{name}", LENGTH, len(value)
            for i, item in enumerate(value):
                yield from _leaf(item, sequence.group(1), f"{prefix}{name}.{i}")
        else:
            yield from _leaf(value, kind, f"{prefix}{name}")


def _leaf(value: Any, kind: str, path: str) -> Iterator[tuple[str, str, Any]]:
    if kind == STRING or kind in FORMATS:
        yield path, kind, value
    else:
        yield from _fields(value, f"{path}.")


class Field(NamedTuple):
    """Where numbers of one format stand in a stream: format, and indices among the numbers of that format."""

    form: str
    places: NDArray[np.int64]


class Room:
    """Bytes of a message: all of them, and the stream by format of its numbers."""

    def __init__(self, size: int) -> None:
        """Make room for `size` bytes, the encapsulation included; the stream begins at a multiple of eight."""
        room = np.zeros(HEADER + size, np.uint8)
        self.all = room[HEADER:]
        stream = room[2 * HEADER :]
        self.of = {
            form: stream[: len(stream) // int(form[1]) * int(form[1])].view(f"<{form}") for form in FORMATS.values()
        }


class Template:
    """The bytes of a message whose strings and lengths stay; it begins with a header's stamp.

    `sent` is what is written and published, `come` the newest message of its shape that was taken.
    """

    def __init__(self, message: Any) -> None:
        """Lay out `message`; its numbers may be changed later, its strings and lengths may not."""
        serialised = np.frombuffer(serialize_message(message), np.uint8)
        self._places, shape, end = places(message)
        # Padding is zero, between fields and at the end, where DDS fills up a word: equal runs, equal bytes.
        # (rclpy leaves room after empty sequences that the stream does not need.)
        self.sent, self.come = Room(-(-(HEADER + end) // 4) * 4), Room(HEADER + end)
        self._shape = np.array(shape, np.int64) + HEADER
        self._names = serialised[self._shape]
        used = [np.arange(offset, offset + int(form[1])) + HEADER for offset, form in self._places.values()]
        for part in (np.arange(HEADER), self._shape, *used):
            self.sent.all[part] = serialised[part]
        self._tick = self._places["tick"][0] // 8
        self._take = specialised(take, serialised, self.come.all, self._shape, self._names)

    def index(self, paths: Iterable[str]) -> Field:
        """The fields of some paths, all of one format."""
        known = [self._places[path] for path in paths]
        form = known[0][1] if known else "f8"
        return Field(form, np.array([offset // int(form[1]) for offset, _ in known], np.int64))

    def write(self, field: Field, values: Any) -> None:
        """Put values into fields of what is sent."""
        self.sent.of[field.form][field.places] = values

    def write_head(self, start_ns: int, tick: int) -> None:
        """Put the stamp of the header and the tick."""
        of = self.sent.of
        of["i4"][0], of["u4"][1] = divmod(start_ns, NANOSECONDS)
        of["u8"][self._tick] = tick

    def data(self) -> bytes:
        """The message as it stands, to be published raw."""
        return self.sent.all.tobytes()

    def take(self, data: bytes) -> bool:
        """Take a message if it is of this shape: equal but for its numbers (and what pads it)."""
        return bool(self._take(np.frombuffer(data, np.uint8), self.come.all, self._shape, self._names))

    def tick(self) -> int:
        """Tick of the message that was taken."""
        return int(self.come.of["u8"][self._tick])

    def start_ns(self) -> int:
        """Stamp of its header, ns."""
        of = self.come.of
        return int(of["i4"][0]) * NANOSECONDS + int(of["u4"][1])

    def read(self, field: Field) -> NDArray[Any]:
        """Values of its fields."""
        return self.come.of[field.form][field.places]
