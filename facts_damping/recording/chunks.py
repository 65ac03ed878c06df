"""Unpacks chunks of MCAP files within bounds, so that a few bytes cannot fill the memory."""

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

ROOM = 4 << 20  # bytes that the chunks of any file may unpack to
RATIO = 30  # more bytes per byte of the file up to the chunk's end; recordings of a graph take 3 to 10
HEAD = Struct("<BQ")  # of a record: opcode, length of content
INSIDE = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE))  # kinds of record that a chunk may hold


PLAIN = frozenset((Opcode.MESSAGE, Opcode.CHUNK, Opcode.CHUNK_INDEX))  # kinds that a recording has in any number
MAX_OTHERS, OTHERS_A_CHUNK = 10_000, 200  # limits for other records: indices of channels in chunks, schemas, ...


def check_counts(data: bytes, name: str) -> None:
    """Raise RecordingError, before reading, if a file has too many records: a million take one second to read."""
    at, others, allowed = len(MCAP0_MAGIC), 0, MAX_OTHERS
    while at + HEAD.size <= len(data):
        opcode, length = HEAD.unpack_from(data, at)
        allowed += OTHERS_A_CHUNK * (opcode == Opcode.CHUNK)
        others += opcode not in PLAIN
        if others > allowed:
            raise RecordingError(f"{name}: more than {allowed} records beside messages; allowed: those of a recording")
        at += HEAD.size + length


class UnpackLimit:
    """Limits the number of bytes that the chunks of a file may unpack to."""

    def __init__(self) -> None:
        self._size = 0

    def has(self, chunk: Chunk, end: int) -> bool:
        """Whether a chunk fits; if so, its size is counted. `end`: byte of the file at which it ends."""
        fits = self._size + chunk.uncompressed_size <= ROOM + RATIO * end
        self._size += chunk.uncompressed_size if fits else 0
        return fits


def may_pack(size: int, end: int) -> bool:
    """Whether a writer may pack a chunk that ends later than byte `end`; `size`: bytes that all chunks unpack to.

    Equal messages pack so well that `UnpackLimit` would take a file of them for a bomb. It leaves half of `ROOM` for
    other records.
    """
    return size <= ROOM // 2 + RATIO * end


def unpack(chunk: Chunk) -> list[McapRecord]:
    """Records in a chunk, checksum verified. Raises ValueError, or the libraries' own errors if damaged."""
    data, at = _plain(chunk), 0
    while at < len(data):  # before they are read: a few bytes can pack a million records of a kind that is not allowed
        opcode, length = HEAD.unpack_from(data, at)
        if opcode not in INSIDE:
            raise ValueError(f"a record of kind {opcode} in a chunk")
        at += HEAD.size + length
    return breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)


def _plain(chunk: Chunk) -> bytes:
    """Unpacked data of a chunk; its size must be as stated. Raises as `unpack` does."""
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        if zstandard.get_frame_parameters(chunk.data).content_size not in (size, zstandard.CONTENTSIZE_UNKNOWN):
            raise ValueError("a chunk is not of its stated size")
        data = zstandard.decompress(chunk.data, max_output_size=size)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression} is not known")
    if len(data) != size:
        raise ValueError("a chunk is not of its stated size")
    return data
