"""Chunks of MCAP files, unpacked within bounds: a few bytes must not fill the memory."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import lz4.frame
import zstandard
from mcap.stream_reader import breakup_chunk

from facts_damping.errors import RecordingError

if TYPE_CHECKING:
    from mcap.records import Chunk, McapRecord

ROOM = 4 << 20  # bytes that the chunks of any file may unpack to,
RATIO = 100  # and so many for each byte of the file up to them: recordings of a graph take 3 to 10


class Room:
    """How many bytes the chunks of a file may unpack to."""

    def __init__(self, name: str) -> None:
        """`name`: of the file."""
        self._name, self._taken = name, 0

    def unpack(self, chunk: Chunk, end: int) -> list[McapRecord]:
        """Records in a chunk, which fits its checksum; `end`: where it ends in the file.

        Raises RecordingError where the chunks so far are too large, anything else where this one is damaged.
        """
        self._taken += chunk.uncompressed_size
        if self._taken > ROOM + RATIO * end:
            most = f"{RATIO} times as much as it has, and {ROOM} bytes"
            raise RecordingError(f"{self._name}: unpacks to {self._taken} bytes within {end}; allowed: {most}")
        return breakup_chunk(replace(chunk, compression="", data=_plain(chunk)), validate_crc=True)


def _plain(chunk: Chunk) -> bytes:
    """The data of a chunk, as large as it says. Raises ValueError, or what the libraries have for damage."""
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
