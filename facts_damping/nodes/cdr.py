"""Messages as bytes: fields of a message whose shape stays are written and read in place.

rclpy converts a message field by field, object by object; for a frame of five stations that costs more
than the transport. Where names and lengths stay the same from tick to tick, so does the place of
every number in the CDR stream (little-endian, plain CDR as DDS-XTypes 1.3, 7.4.1 has it: a primitive is
aligned to its size). A `Template` knows these places and is published as raw bytes; a message that
does not fit it is read by rclpy as usual.
"""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message

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
    "uint64": "u8",
    "double": "f8",
}
_STAMP, _TICK = struct.Struct("<iI"), struct.Struct("<Q")
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


class Template:
    """The bytes of a message whose strings and lengths stay; it begins with a header's stamp."""

    def __init__(self, message: Any) -> None:
        """Lay out `message`; its numbers may be changed later, its strings and lengths may not."""
        serialised = np.frombuffer(serialize_message(message), np.uint8)
        self._places, shape, end = places(message)
        self._shape = np.array(shape) + HEADER
        self._constant = serialised[self._shape].tobytes()
        self._tick = HEADER + self._places["tick"][0]
        # Padding is zero, between fields and at the end, where DDS fills up a word: equal runs, equal bytes.
        # (rclpy leaves room after empty sequences that the stream does not need.)
        self._buffer = bytearray(_words(HEADER + end))
        kept = np.frombuffer(self._buffer, np.uint8)
        used = [np.arange(offset, offset + int(form[1])) + HEADER for offset, form in self._places.values()]
        for part in (np.arange(HEADER), self._shape, *used):
            kept[part] = serialised[part]
        self._views = {form: _numbers(self._buffer, form) for form in FORMATS.values()}

    def index(self, paths: Iterable[str]) -> Field:
        """The fields of some paths, all of one format."""
        known = [self._places[path] for path in paths]
        form = known[0][1] if known else "f8"
        return Field(form, np.array([offset // int(form[1]) for offset, _ in known], np.int64))

    def write(self, field: Field, values: Any) -> None:
        """Put values into fields."""
        self._views[field.form][field.places] = values

    def write_head(self, start_ns: int, tick: int) -> None:
        """Put the stamp of the header and the tick."""
        _STAMP.pack_into(self._buffer, HEADER, *divmod(start_ns, NANOSECONDS))
        _TICK.pack_into(self._buffer, self._tick, tick)

    def data(self) -> bytes:
        """The message as it stands, to be published raw."""
        return bytes(self._buffer)

    def fits(self, data: bytes) -> bool:
        """Whether `data` is a message of this shape: equal but for its numbers (and what pads it)."""
        if _words(len(data)) < len(self._buffer):
            return False
        return bool(np.frombuffer(data, np.uint8)[self._shape].tobytes() == self._constant)

    def tick_of(self, data: bytes) -> int:
        """Tick of a message that fits."""
        return int(_TICK.unpack_from(data, self._tick)[0])

    def start_of(self, data: bytes) -> int:
        """Stamp of the header of a message that fits, ns."""
        sec, nanosec = _STAMP.unpack_from(data, HEADER)
        return int(sec * NANOSECONDS + nanosec)


def read(data: bytes, field: Field) -> NDArray[Any]:
    """Values of fields in a message that fits their template."""
    return _numbers(data, field.form)[field.places]


def _numbers(data: bytes | bytearray, form: str) -> NDArray[Any]:
    """The stream as numbers of one format."""
    return np.frombuffer(data, f"<{form}", (len(data) - HEADER) // int(form[1]), HEADER)


def _words(size: int) -> int:
    """A size filled up to whole words of four bytes."""
    return -(-size // 4) * 4
