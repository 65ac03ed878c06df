"""Chunks of MCAP files, unpacked within bounds: a few bytes must not fill the memory."""

from __future__ import annotations

from dataclasses import replace
from struct import Struct
from typing import TYPE_CHECKING

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from facts_damping.errors import RecordingError

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

ROOM = 4 << 20  # bytes that the chunks of any file may unpack to,
RATIO = 30  # and so many for each byte of the file up to them: recordings of a graph take 3 to 10
HEAD = Struct("<BQ")  # of a record: opcode, length of its content
INSIDE = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))  # all that a chunk holds, by the format


PLAIN = frozenset((Opcode.MESSAGE, Opcode.CHUNK, Opcode.CHUNK_INDEX))  # of which a recording has any number
MOST_OTHERS, OTHERS_A_CHUNK = 10_000, 200  # other records: an index a channel of each chunk, a schema a type, ...


def check_counts(data: bytes, name: str) -> None:
    """Raise RecordingError for a file of more records than one has, before they are read: a second takes a million."""
    at, others, allowed = len(MCAP0_MAGIC), 0, MOST_OTHERS
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        allowed += OTHERS_A_CHUNK * (opcode == Opcode.CHUNK)
        others += opcode not in PLAIN
        if others > allowed:
            raise RecordingError(f"{name}: more than {allowed} records beside messages; allowed: those of a recording")
        at += HEAD.size + length


class UnpackLimit:
    """How many bytes the chunks of a file may unpack to."""

    def __init__(self) -> None:
        self._taken = 0

    def has(self, chunk: Chunk, end: int) -> bool:
        """Whether there is room for a chunk, which then counts; `end`: where it ends in the file."""
        fits = self._taken + chunk.uncompressed_size <= ROOM + RATIO * end
        self._taken += chunk.uncompressed_size if fits else 0
        return fits


def unpack(chunk: Chunk) -> list[McapRecord]:
    """Records in a chunk, which fits its checksum. Raises ValueError, or what the libraries have for damage."""
    data = _plain(chunk)
    _check_kinds(data)
    return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)


def _check_kinds(data: bytes) -> None:
    """Refuse what is no record of a chunk before any is read: a million empty ones fit into a few bytes."""
    at = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at)
        if opcode not in INSIDE:
            raise ValueError(f"a record of kind {opcode} in a chunk")
        at += HEAD.size + length


def _plain(chunk: Chunk) -> bytes:
    """The data of a chunk, as large as it says. Raises as `unpack` does."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        told = zstandard.get_frame_parameters(chunk.data).content_size
        if told not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError("a chunk is not as large as it says")
        data = zstandard.decompress(chunk.data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression} is not known")
    if len(data) != size:
        raise ValueError("a chunk is not as large as it says")
    return data
