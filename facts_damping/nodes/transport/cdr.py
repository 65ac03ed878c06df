"""Messages as bytes: fields of a message whose shape stays are written and read in place.

rclpy converts a message field by field, object by object; for a frame of five stations that costs more
than the transport. Where names and lengths stay the same from tick to tick, so does the place of
every number in the CDR stream (little-endian, plain CDR as DDS-XTypes 1.3, 7.4.1 has it: a primitive is
aligned to its size). A `Template` knows these places and is published as raw bytes. A message is read by
a template that it fits, byte by byte but for its numbers, and refused if there is none.
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


LONGEST = 1 << 24  # bytes of a message: a tick's entries are far less, also when many come at once

SIZES = {form: np.dtype(form).itemsize for form in FORMATS.values()}  # bytes


@cache
def _fields(message_type: str) -> Mapping[str, Any]:
    """What a message type and those that it is made of consist of."""
    return parse_schema(message_type, schema_text(message_type))


class Refused(Exception):  # noqa: N818 (not an error: the message is, and the node goes on)
    """A message that is not to be used; `cause` as in RefusedCount.msg."""

    def __init__(self, cause: str) -> None:
        super().__init__(cause)
        self.cause = cause


def _walk(kind: type[Any], serialised: NDArray[np.uint8]) -> tuple[Walk, SimpleNamespace]:
    """Where things stand in a message, and what it says."""
    message_type = f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"
    walk = Walk(serialised[np.newaxis], _fields(message_type))
    return walk, walk.read(message_type)


def content(data: bytes, kind: type[Any]) -> SimpleNamespace:
    """What a message of that type says, read within its bounds; numbers are arrays of one.

    Raises `Refused` where it is no such message.
    """
    if len(data) > LONGEST:
        raise Refused("length")
    try:
        return _walk(kind, np.frombuffer(data, np.uint8))[1]
    except ValueError as error:
        raise Refused("format") from error


class Field(NamedTuple):
    """Where numbers of one format stand in a stream: format, and indices among the numbers of that format."""

    form: str
    places: NDArray[np.int64]


class BufferSpace:
    """Bytes of a message: all of them, and the stream by format of its numbers."""

    def __init__(self, size: int) -> None:
        """Make room for `size` bytes, the encapsulation included; the stream begins at a multiple of eight."""
        room = np.zeros(HEADER + size, np.uint8)
        self.all = room[HEADER:]
        stream = room[2 * HEADER :]
        self.of = {form: stream[: len(stream) // size * size].view(f"<{form}") for form, size in SIZES.items()}


class Template:
    """The bytes of a message whose strings and lengths stay; it begins with a header's stamp.

    `sent` is what is written and published, `come` the newest message of its shape that was taken.
    """

    def __init__(self, message: Any) -> None:
        """Lay out `message`; its numbers may be changed later, its strings and lengths may not."""
        serialised = np.frombuffer(serialize_message(message), np.uint8)
        walk, _ = _walk(type(message), serialised)
        self._places = {path: (offset - HEADER, form) for path, (offset, form) in walk.places.items()}
        # Padding is zero, between fields and at the end, where DDS fills up a word: equal runs, equal bytes.
        # (rclpy leaves room after empty sequences that the stream does not need.)
        self.sent, self.come = BufferSpace(-(-walk.end // 4) * 4), BufferSpace(walk.end)
        self._shape = np.concatenate([np.arange(HEADER // 2), *walk.shape[1:]])  # the kind of CDR, strings and lengths
        self._names = serialised[self._shape]
        used = [np.arange(offset, offset + SIZES[form]) + HEADER for offset, form in self._places.values()]
        for part in (np.arange(HEADER), self._shape, *used):
            self.sent.all[part] = serialised[part]
        self._tick = self._places["tick"][0] // 8

    def index(self, paths: Iterable[str]) -> Field:
        """The fields of some paths, all of one format."""
        known = [self._places[path] for path in paths]
        form = known[0][1] if known else "f8"
        return Field(form, np.array([offset // SIZES[form] for offset, _ in known], np.int64))

    def write(self, field: Field, values: Any) -> None:
        """Put values into fields of what is sent."""
        self.sent.of[field.form][field.places] = values

    def write_head(self, start_ns: int, tick: int) -> None:
        """Put the stamp of the header and the tick."""
        of = self.sent.of
        of["i4"][0], of["u4"][1] = divmod(start_ns + epoch_ns(), NANOSECONDS)
        of["u8"][self._tick] = tick

    def data(self) -> bytes:
        """The message as it stands, to be published raw."""
        return self.sent.all.tobytes()

    def take(self, data: bytes) -> bool:
        """Take a message if it is of this shape: as long, and equal but for its numbers (and what pads it)."""
        return bool(take(np.frombuffer(data, np.uint8), self.come.all, self._shape, self._names))

    def tick(self) -> int:
        """Tick of the message that was taken."""
        return int(self.come.of["u8"][self._tick])

    def start_ns(self) -> int:
        """Stamp of its header, ns, simulated."""
        of = self.come.of
        return int(of["i4"][0]) * NANOSECONDS + int(of["u4"][1]) - epoch_ns()

    def read(self, field: Field) -> NDArray[Any]:
        """Values of its fields."""
        return self.come.of[field.form][field.places]
