"""Messages as bytes: numbers of a message of constant shape are written and read in place.

rclpy converts a message field by field; for a frame of five PMUs that costs more than the transport.
If names and lengths stay the same from tick to tick, so does the position of every number in the CDR stream
(little-endian, plain CDR of DDS-XTypes 1.3, 7.4.1: a primitive is aligned to its size). A `Template` knows these
positions and is published as raw bytes. A received message must match its template in all bytes except its numbers.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message

from facts_damping.nodes.transport.packing import take
from facts_damping.nodes.transport.stamps import epoch_ns
from facts_damping.recording.columns import FORMATS, HEADER, Walk
from facts_damping.recording.schemas import parse_schema, schema_text
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from types import SimpleNamespace

    from numpy.typing import NDArray


LONGEST = 1 << 24  # largest message accepted, bytes: far more than the entries of a tick, even if many arrive at once

SIZES = {form: np.dtype(form).itemsize for form in FORMATS.values()}  # bytes


@cache
def _fields(message_type: str) -> Mapping[str, Any]:
    """Fields of a message type and of the types that it contains."""
    return parse_schema(message_type, schema_text(message_type))


class Refused(Exception):  # noqa: N818 (not an error: the message is, and the node goes on)
    """A message must not be used; `cause` as in RefusedCount.msg."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause


def _walk(kind: type[Any], serialised: NDArray[np.uint8]) -> tuple[Walk, SimpleNamespace]:
    """Positions of the fields in a message, and its content."""
    message_type = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
    walk = Walk(serialised[np.newaxis], _fields(message_type))
    return walk, walk.read(message_type)


def content(data: bytes, kind: type[Any]) -> SimpleNamespace:
    """Decode a message of a type with bounds checks; numbers are arrays of one element.

    Raises `Refused` if the bytes are no such message.
    """
    if len(data) > LONGEST:
        raise Refused("length")
    try:
        return _walk(kind, np.frombuffer(data, np.uint8))[1]
    except ValueError as error:
        raise Refused("format") from error


class Field(NamedTuple):
    """Positions of numbers of one format: indices into the stream viewed as an array of that format."""

    form: str
    places: NDArray[np.int64]


class BufferSpace:
    """Buffer of a message: all bytes, and views of the stream by number format."""

    def __init__(self, size: int) -> None:
        """Allocate `size` bytes, encapsulation included; the stream is aligned to eight bytes."""
        room = np.zeros(HEADER + size, np.uint8)
        self.all = room[HEADER:]
        stream = room[2 * HEADER :]
        self.of = {form: stream[: len(stream) // size * size].view(f"<{form}") for form, size in SIZES.items()}


class Template:
    """Bytes of a message with constant strings and lengths; the message begins with a header.

    `sent`: buffer to be written and published; `received`: newest received message of this shape.
    """

    def __init__(self, message: Any) -> None:
        """Lay out `message`; its numbers may be changed later, its strings and lengths may not."""
        self._kind, serialised = type(message), np.frombuffer(serialize_message(message), np.uint8)
        walk, _ = _walk(self._kind, serialised)
        self._places = {path: (offset - HEADER, form) for path, (offset, form) in walk.places.items()}
        # Padding between fields and up to a multiple of four at the end is zero, so that equal runs give equal bytes.
        # (rclpy leaves room after empty sequences that the stream does not need.)
        self.sent, self.received = BufferSpace(-(-walk.end // 4) * 4), BufferSpace(walk.end)
        self._shape = np.concatenate([np.arange(HEADER // 2), *walk.shape[1:]])  # encapsulation, strings, lengths
        self._names = serialised[self._shape]
        used = [np.arange(offset, offset + SIZES[form]) + HEADER for offset, form in self._places.values()]
        for part in (np.arange(HEADER), self._shape, *used):
            self.sent.all[part] = serialised[part]
        self._tick = self._places["tick"][0] // 8

    def index(self, paths: Iterable[str]) -> Field:
        """Positions of the fields at some paths, all of one format."""
        known = [self._places[path] for path in paths]
        form = known[0][1] if known else "f8"
        return Field(form, np.array([offset // SIZES[form] for offset, _ in known], np.int64))

    def write(self, field: Field, values: Any) -> None:
        """Write values into the message to be sent."""
        self.sent.of[field.form][field.places] = values

    def write_head(self, start_ns: int, tick: int) -> None:
        """Write the header stamp and the tick; `start_ns`: simulated time."""
        of = self.sent.of
        of["i4"][0], of["u4"][1] = divmod(start_ns + epoch_ns(), NANOSECONDS)
        of["u8"][self._tick] = tick

    def data(self) -> bytes:
        """The message to be sent, for raw publication."""
        return self.sent.all.tobytes()

    def take(self, data: bytes) -> None:
        """Keep a received message of this shape: same length, same bytes except numbers and padding.

        Raises `Refused` for any other message.
        """
        if not take(np.frombuffer(data, np.uint8), self.received.all, self._shape, self._names):
            content(data, self._kind)  # raises for bytes that are no such message
            raise Refused("names")

    def tick(self) -> int:
        """Tick of the received message."""
        return int(self.received.of["u8"][self._tick])

    def start_ns(self) -> int:
        """Header stamp of the received message, ns of simulated time."""
        of = self.received.of
        return int(of["i4"][0]) * NANOSECONDS + int(of["u4"][1]) - epoch_ns()

    def read(self, field: Field) -> NDArray[Any]:
        """Values of fields of the received message."""
        return self.received.of[field.form][field.places]
