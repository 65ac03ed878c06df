"""Decodes CDR messages column-wise: messages with the same strings and lengths yield one array per number.

An hour of recording has more than a million messages; decoding them one by one takes minutes. From tick to tick only
numbers change, so they stay at the same offsets (plain CDR, DDS-XTypes 1.3, 7.4.1: a primitive is aligned to its size,
counted after the four bytes of encapsulation).
"""

from __future__ import annotations

import struct
import sys
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype

from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

HEADER = 4  # bytes of encapsulation at the start of a message
FORMATS = {
    "bool": "?", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4",
    "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
SIZES = {form: np.dtype(form).itemsize for form in FORMATS.values()}
PASSES = 30  # layouts to compare with all messages of one length; the remaining messages are then parsed one by one


def stamp_ns(cdr: bytes) -> int:
    """Time in the header at the start of a message, ns; 0 if before 0.

    The stamp is the first eight bytes after the encapsulation, whose second byte gives the byte order.
    """
    sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, HEADER)
    return max(0, int(sec) * NANOSECONDS + int(nanosec))


class Block(NamedTuple):
    """Messages that differ only in their numbers: their places in a list, (n,), and all of them as one message.

    The message has the fields of its type. A number is an array (n,); strings and sequences are as in a single message.
    """

    rows: NDArray[np.int64]
    message: Any


def blocks(data: Sequence[bytes], fields: Mapping[str, Any], message_type: str) -> tuple[list[Block], int]:
    """Blocks of messages of one type, in order of first appearance, and the number of messages left out as invalid.

    `fields`: fields of each type, as `rosbags` gives them. Places do not count messages that are left out.
    """
    lengths = np.array([len(message) for message in data], np.int64)
    read: list[Block] = []
    for length in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == length)
        stacked = np.frombuffer(b"".join([data[row] for row in rows.tolist()]), np.uint8).reshape(len(rows), length)
        parts = _alike(stacked, fields, message_type)
        read += [Block(rows[part], Walk(stacked[part], fields).read(message_type)) for part in parts]
    return counted(sorted(read, key=lambda part: int(part.rows[0]))), len(data) - sum(len(part.rows) for part in read)


def counted(typed_blocks: list[Block]) -> list[Block]:
    """Blocks renumbered so that places have no gaps."""
    places = np.sort(np.concatenate([block.rows for block in typed_blocks])) if typed_blocks else np.zeros(0, np.int64)
    return [block._replace(rows=np.searchsorted(places, block.rows)) for block in typed_blocks]


def kept(block: Block, rows: NDArray[np.int64]) -> Block:
    """A block with new places `rows`; messages with a negative place are left out."""
    keep = rows >= 0
    return Block(rows[keep], block.message if keep.all() else _kept(block.message, keep))


def _kept(value: Any, keep: NDArray[np.bool_]) -> Any:
    if isinstance(value, SimpleNamespace):
        return SimpleNamespace(**{name: _kept(member, keep) for name, member in vars(value).items()})
    if isinstance(value, list):
        return [_kept(member, keep) for member in value]
    return value[keep] if isinstance(value, np.ndarray) else value


def _alike(stacked: NDArray[np.uint8], fields: Mapping[str, Any], message_type: str) -> Iterator[NDArray[np.int64]]:
    """Group messages of one length, (n, length), by layout. Yields indices; invalid messages are left out."""
    left, passes = np.arange(len(stacked)), 0
    while len(left) and passes < PASSES:
        shape = _shape(stacked[left[0]], fields, message_type)
        if shape is None:
            left = left[1:]
            continue
        passes += 1
        same = np.all(stacked[left][:, shape] == stacked[left[0], shape], axis=1)
        yield left[same]
        left = left[~same]
    layouts: dict[tuple[bytes, bytes], list[int]] = {}
    for row in left.tolist():
        shape = _shape(stacked[row], fields, message_type)
        if shape is not None:
            layouts.setdefault((shape.tobytes(), stacked[row, shape].tobytes()), []).append(row)
    yield from map(np.array, layouts.values())


def _shape(message: NDArray[np.uint8], fields: Mapping[str, Any], message_type: str) -> NDArray[np.int64] | None:
    """Offsets of the bytes that define the layout: encapsulation, strings and lengths; None for an invalid message."""
    try:
        walk = Walk(message[np.newaxis], fields, numbers=False)
        walk.read(message_type)
    except ValueError:
        return None
    return np.concatenate(walk.shape)


class Walk:
    """Reads messages of one layout, (n, length), field by field.

    `shape`: offsets of the bytes that define the layout: encapsulation, strings and lengths; `places`: offset and
    format of each number by its path ("frames.0.tick"); `end`: offset behind the last field read. Offsets count from
    byte 0.
    """

    def __init__(self, stacked: NDArray[np.uint8], fields: Mapping[str, Any], *, numbers: bool = True) -> None:
        """`numbers`: whether to read the numbers or only find their offsets."""
        self._stacked, self._fields, self.end, self._numbers = stacked, fields, HEADER, numbers
        self._messages = 0  # number read, nested ones included
        self.shape = [np.arange(HEADER)]
        self.places: dict[str, tuple[int, str]] = {}
        if stacked.shape[1] < HEADER or stacked[0, 0] != 0 or stacked[0, 1] > 1:
            raise ValueError("a message is not in plain CDR")
        self._order, self._first = "<" if stacked[0, 1] else ">", stacked[0].tobytes()
        self._swapped = (self._order == "<") != (sys.byteorder == "little")

    def read(self, message_type: str, path: str = "") -> SimpleNamespace:
        """Message of that type at the current position; `path`: path of its field, with a final dot."""
        self._messages += 1
        if self._messages > self._stacked.shape[1]:
            raise ValueError("a message has more parts than bytes")
        fields = self._fields[message_type][1]
        return SimpleNamespace(**{name: self._value(kind, f"{path}{name}") for name, kind in fields})

    def _value(self, kind: Any, path: str) -> Any:
        node, what = kind
        if node == Nodetype.NAME:
            return self.read(what, f"{path}.")
        if node == Nodetype.BASE:
            return self._string() if what[0] == "string" else self._number(FORMATS[what[0]], path)
        item, count = what
        several = self._length() if node == Nodetype.SEQUENCE else count
        if several > self._stacked.shape[1] - self.end:
            raise ValueError("a message is shorter than stated")
        return [self._value(item, f"{path}.{i}") for i in range(several)]

    def _number(self, form: str, path: str) -> Any:
        """One number of each message, (n,)."""
        size = SIZES[form]
        begin = self._pass(size, size)
        self.places[path] = (begin, form)
        if not self._numbers:
            return None
        numbers = np.ascontiguousarray(self._stacked[:, begin : self.end]).view(self._order + form)[:, 0]
        return numbers.astype(form) if self._swapped else numbers

    def _length(self) -> int:
        """Length, the same in all messages. ValueError if it exceeds the bytes left: each item takes at least one."""
        begin = self._pass(4, 4)
        length = int.from_bytes(self._first[begin : self.end], "little" if self._order == "<" else "big")
        if length > len(self._first) - self.end:
            raise ValueError("a message is shorter than stated")
        self.shape.append(np.arange(begin, self.end))
        return length

    def _string(self) -> str:
        size = self._length()
        begin = self._pass(size, 1)
        self.shape.append(np.arange(begin, self.end))
        text = self._first[begin : self.end]
        if not text.endswith(b"\0"):
            raise ValueError("a string does not end with 0")
        return str(text[:-1], "utf-8")

    def _pass(self, size: int, aligned: int) -> int:
        """Skip the next `size` bytes after alignment; returns the offset at which they begin."""
        begin = self.end + -(self.end - HEADER) % aligned
        self.end = begin + size
        if self.end > len(self._first):
            raise ValueError("a message is too short")
        return begin
