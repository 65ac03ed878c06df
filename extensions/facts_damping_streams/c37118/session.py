"""Server and client of a stream without sockets: answers to commands, and decoding of received bytes."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

from facts_damping_streams.c37118 import configuration, data, frame
from facts_damping_streams.c37118.configuration import TIME_BASE
from facts_damping_streams.c37118.frame import Frame, FrameError
from facts_damping_streams.c37118.stat import CHANGE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_streams.c37118.configuration import Configuration
    from facts_damping_streams.c37118.data import Data, Layout

MAX_PARTS = 64  # of a configuration 3
ANSWERS = {f"send_{kind}": kind for kind in ("configuration_1", "configuration_2", "configuration_3")}


class Stream(NamedTuple):
    """A stream to send: its IDCODE, its configuration, and a header text."""

    idcode: int
    configuration: Configuration
    layout: Layout
    header: str = ""


class Instant(NamedTuple):
    """A data frame: its time, s and parts of TIME_BASE, its quality (table 3), the values."""

    soc: int
    fraction: int
    quality: int
    data: Data


def stream(idcode: int, announced: Configuration, header: str = "") -> Stream:
    """A stream of a configuration. Raises `FrameError` if a name or a frame is too long."""
    new_stream = Stream(idcode, announced, data.layout(announced), header)
    for name in ANSWERS:
        answers(new_stream, name, 0, 0)
    return new_stream


def data_frame(served: Stream, instant: Instant) -> bytes:
    """A data frame."""
    body = data.encode(served.layout, instant.data)
    return frame.encode(Frame("data", served.idcode, instant.soc, instant.fraction, body, instant.quality))


def commanded(served: Stream, raw: bytes) -> str:
    """The name of the command in bytes for a stream. Raises `FrameError` if there is none."""
    command = frame.decode(raw)
    if command.kind != "command":
        raise FrameError(f"SYNC: a {command.kind} frame; allowed: commands (6.6)")
    if command.idcode != served.idcode:
        raise FrameError(f"IDCODE: {command.idcode} given; allowed: {served.idcode} (6.2)")
    return frame.command_of(command)


def answers(served: Stream, name: str, soc: int, fraction: int) -> list[bytes]:
    """A server's answer to a command; empty for commands that start and stop data."""
    if name == "send_header":
        return [frame.encode(Frame("header", served.idcode, soc, fraction, served.header.encode()))]
    kind = ANSWERS.get(name)
    bodies = [] if kind is None else configuration.encode(served.configuration, kind)
    return [frame.encode(Frame(kind or "", served.idcode, soc, fraction, body)) for body in bodies]


class Receiver:
    """Decodes received bytes to configurations and instants; invalid bytes are counted."""

    def __init__(self, idcode: int | None = None) -> None:
        """`idcode`: of the stream; None: the first one received."""
        self.stream, self._idcode = bytearray(), idcode
        self.layout: Layout | None = None
        self._known: Configuration | None = None
        self._announced = False  # whether a change has been announced
        self.parts: list[bytes] = []  # of a configuration 3
        self.changed = True  # whether to request a configuration
        self.lost_bytes, self.refused = 0, Counter[str]()  # refused frames by invalid field
        self.why = ""  # reason of the latest refusal

    def feed(self, received: bytes) -> list[Configuration | Instant | str]:
        """Results completed by these bytes: a configuration, an instant, or a header's text."""
        self.stream += received
        frames, lost = frame.split(self.stream)
        self.lost_bytes += lost
        return self.take(frames)

    def take(self, frames: Sequence[bytes]) -> list[Configuration | Instant | str]:
        """The same for whole frames, such as datagrams."""
        contents: list[Configuration | Instant | str] = []
        for raw in frames:
            try:
                content = self._read(frame.decode(raw))
            except FrameError as error:
                self.refused[error.field] += 1
                self.why = str(error)
            else:
                contents += [] if content is None else [content]
        return contents

    def _read(self, received: Frame) -> Configuration | Instant | str | None:
        if self._idcode not in (None, received.idcode):
            raise FrameError(f"IDCODE: {received.idcode} given; allowed: {self._idcode} (6.2)")
        if received.kind == "header":
            return received.body.decode(errors="replace")
        if received.kind == "data":
            return self._instant(received)
        if received.kind == "command":
            raise FrameError("CMD: a command from a server; allowed: data, headers, configurations (6.6)")
        bodies = [received.body]
        if received.kind == "configuration_3":
            self.parts = bodies = self._part(received.body)
            if not configuration.whole(bodies):
                return None
            self.parts = []
        decoded = configuration.decode(bodies, received.kind)
        if received.kind == "configuration_1":  # it has the available channels, not those sent
            return None
        self.layout, self.changed = data.layout(decoded), False
        self._announced, self._known = self._announced and decoded == self._known, decoded
        return decoded

    def _part(self, body: bytes) -> list[bytes]:
        """The parts of a configuration 3 so far; empty if one is out of order or there are too many."""
        index, before = int.from_bytes(body[:2], "big"), self.parts
        self.parts = []
        if index <= configuration.FIRST:
            return [body]
        if index not in (len(before) + 1, configuration.LAST) or len(before) >= MAX_PARTS:
            raise FrameError(f"CONT_IDX: {index} given; allowed: {len(before) + 1} to {MAX_PARTS}, or the last (6.4)")
        return [*before, body]

    def _instant(self, received: Frame) -> Instant | None:
        """The content of a data frame; None while the configuration is unknown or outdated."""
        if self.layout is None or self._known is None:
            return None
        try:
            frame_data = data.decode(self.layout, received.body)
        except FrameError:
            self.changed = True
            raise
        announced = bool((frame_data.status & CHANGE).any())
        over, self._announced = self._announced and not announced, announced
        self.changed = self.changed or announced or over
        if over:
            self.layout = None  # the configuration is another one from this frame on
            return None
        return Instant(
            received.soc, received.fraction * TIME_BASE // self._known.time_base, received.quality, frame_data
        )
