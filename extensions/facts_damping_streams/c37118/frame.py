"""The common part of all messages (6.2, table 2), command and header frames (6.5, 6.6), and frames in a stream."""

from __future__ import annotations

import struct
from binascii import crc_hqx
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import FactsDampingError

if TYPE_CHECKING:
    from collections.abc import Mapping

SYNC = 0xAA  # first byte of every frame
VERSION = 2  # of the 2011 edition; 1 is the 2005 edition
KINDS: Mapping[str, int] = {  # bits 6 to 4 of the second byte
    "data": 0,
    "header": 1,
    "configuration_1": 2,
    "configuration_2": 3,
    "command": 4,
    "configuration_3": 5,
}
COMMANDS: Mapping[str, int] = {  # table 15
    "turn_off": 1,
    "turn_on": 2,
    "send_header": 3,
    "send_configuration_1": 4,
    "send_configuration_2": 5,
    "send_configuration_3": 6,
    "extended": 8,
}
HEAD = struct.Struct(">BBHHII")  # SYNC, FRAMESIZE, IDCODE, SOC, FRACSEC
CHECK = struct.Struct(">H")  # CHK
MINIMUM, MAXIMUM = HEAD.size + CHECK.size, 0xFFFF  # bytes of a frame


class FrameError(FactsDampingError):
    """An invalid message: what was found, what is allowed, and the clause."""

    @property
    def field(self) -> str:
        """The invalid field, for statistics: the text before what was found."""
        return str(self).partition(":")[0]


class Frame(NamedTuple):
    """A message: its kind and common fields; `body` is the part between these and the check word."""

    kind: str
    idcode: int  # of its stream, 1 to 65534
    soc: int  # s since 1970 (UTC)
    fraction: int  # of a second, in parts of TIME_BASE, 24 bits
    body: bytes = b""
    quality: int = 0  # bits 31 to 24 of FRACSEC: leap seconds and the clock's quality (table 3)
    version: int = VERSION


def checksum(data: bytes) -> int:
    """CHK: the cyclic redundancy check x^16 + x^12 + x^5 + 1, initial value -1, of all bytes before it (annex B)."""
    return crc_hqx(data, 0xFFFF)


def encode(frame: Frame) -> bytes:
    """A message as bytes. Raises `FrameError` if it does not fit."""
    size = MINIMUM + len(frame.body)
    if size > MAXIMUM:
        raise FrameError(f"FRAMESIZE: {size} bytes; allowed: {MINIMUM} to {MAXIMUM} (6.2)")
    second = KINDS[frame.kind] << 4 | frame.version
    fraction = frame.quality << 24 | frame.fraction
    data = HEAD.pack(SYNC, second, size, frame.idcode, frame.soc, fraction) + frame.body
    return data + CHECK.pack(checksum(data))


def decode(data: bytes) -> Frame:
    """A message from bytes. Raises `FrameError` if they are invalid."""
    size = framesize(data)
    if size != len(data):
        raise FrameError(f"FRAMESIZE: {size} in a frame of {len(data)} bytes; allowed: its length (6.2)")
    _, second, _, idcode, soc, fraction = HEAD.unpack_from(data)
    (received_sum,) = CHECK.unpack_from(data, size - CHECK.size)
    if received_sum != (wanted := checksum(data[: -CHECK.size])):
        raise FrameError(f"CHK: {received_sum:#06x} given; allowed: {wanted:#06x} (6.2)")
    kind = next(name for name, code in KINDS.items() if code == second >> 4)
    return Frame(kind, idcode, soc, fraction & 0xFFFFFF, data[HEAD.size : -CHECK.size], fraction >> 24, second & 0xF)


def framesize(data: bytes | bytearray) -> int:
    """FRAMESIZE of a frame from at least its first four bytes. Raises `FrameError` if no frame begins here."""
    if len(data) < MINIMUM:
        raise FrameError(f"FRAMESIZE: a frame of {len(data)} bytes; allowed: {MINIMUM} and more (6.2)")
    first, second, size = data[0], data[1], int.from_bytes(data[2:4], "big")
    if first != SYNC or second >> 4 not in KINDS.values() or second & 0xF not in (1, VERSION):
        raise FrameError(f"SYNC: {data[:2].hex()} given; allowed: aa and a kind of frame of version 1 or 2 (6.2)")
    if size < MINIMUM:
        raise FrameError(f"FRAMESIZE: {size}; allowed: {MINIMUM} and more (6.2)")
    return size


def split(stream: bytearray, maximum: int = MAXIMUM) -> tuple[list[bytes], int]:
    """Remove the complete frames and invalid bytes from a stream; return the frames and the number of invalid bytes.

    A frame that has begun remains. `maximum`: largest size of a valid frame, bytes. An incomplete frame counts as
    invalid if a complete one begins after its start, since its length may be wrong.
    """
    frames, lost, at = list[bytes](), 0, 0
    while len(stream) - at >= MINIMUM:
        whole = _whole(stream, at, maximum)
        if whole:
            lost += at
            frames.append(whole)
            del stream[: at + len(whole)]
            at = 0
            continue
        at = _following(stream, at + 1)
    waits = _begun(stream, maximum)
    del stream[:waits]
    return frames, lost + waits


def _whole(stream: bytearray, at: int, maximum: int) -> bytes | None:
    """The frame that begins here, if it is complete and valid."""
    try:
        size = framesize(stream[at : at + MINIMUM])
        if size > min(maximum, len(stream) - at):
            return None
        whole = bytes(stream[at : at + size])
        decode(whole)
    except FrameError:
        return None
    return whole


def _following(stream: bytearray, at: int) -> int:
    """Position where the next frame may begin."""
    start = stream.find(SYNC, at)
    return len(stream) if start < 0 else start


def _begun(stream: bytearray, maximum: int) -> int:
    """Position where an incomplete frame begins, in a stream without complete ones."""
    at = _following(stream, 0)
    while len(stream) - at >= MINIMUM:
        try:
            if len(stream) - at < framesize(stream[at : at + MINIMUM]) <= maximum:
                break
        except FrameError:
            pass
        at = _following(stream, at + 1)
    return at


def command(idcode: int, name: str, soc: int, fraction: int = 0, extended: bytes = b"") -> bytes:
    """A command frame as bytes (table 14): a name of `COMMANDS`, and the data of an extended command."""
    return encode(Frame("command", idcode, soc, fraction, CHECK.pack(COMMANDS[name]) + extended))


def command_of(frame: Frame) -> str:
    """The name of a command frame's command. Raises `FrameError` if the standard does not define it."""
    if len(frame.body) < CHECK.size:
        raise FrameError("CMD: missing; allowed: two bytes (6.6)")
    (code,) = CHECK.unpack_from(frame.body)
    name = next((name for name, known in COMMANDS.items() if known == code), None)
    if name is None:
        raise FrameError(f"CMD: {code} given; allowed: {', '.join(map(str, COMMANDS.values()))} (6.6)")
    return name
