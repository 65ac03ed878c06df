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


def stream(idcode: int, configuration: Configuration, header: str = "") -> Stream:
    """A stream of a configuration. Raises `FrameError` if a name or a frame is too long."""
    one = Stream(idcode, configuration, data.layout(configuration), header)
    for name in ANSWERS:
        answers(one, name, 0, 0)
    return one


def data_frame(stream: Stream, instant: Instant) -> bytes:
    """A data frame."""
    body = data.encode(stream.layout, instant.data)
    return frame.encode(Frame("data", stream.idcode, instant.soc, instant.fraction, body, instant.quality))


def commanded(stream: Stream, raw: bytes) -> str:
    """The name of the command in bytes for a stream. Raises `FrameError` if there is none."""
    found = frame.decode(raw)
    if found.kind != "command":
        raise FrameError(f"SYNC: a {found.kind} frame; allowed: commands (6.6)")
    if found.idcode != stream.idcode:
        raise FrameError(f"IDCODE: {found.idcode} given; allowed: {stream.idcode} (6.2)")
    return frame.command_of(found)


def answers(stream: Stream, name: str, soc: int, fraction: int) -> list[bytes]:
    """A server's answer to a command; empty for commands that start and stop data."""
    if name == "send_header":
        return [frame.encode(Frame("header", stream.idcode, soc, fraction, stream.header.encode()))]
    kind = ANSWERS.get(name)
    bodies = [] if kind is None else configuration.encode(stream.configuration, kind)
    return [frame.encode(Frame(kind or "", stream.idcode, soc, fraction, body)) for body in bodies]


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
        found: list[Configuration | Instant | str] = []
        for raw in frames:
            try:
                made = self._read(frame.decode(raw))
            except FrameError as error:
                self.refused[error.field] += 1
                self.why = str(error)
            else:
                found += [] if made is None else [made]
        return found

    def _read(self, frame: Frame) -> Configuration | Instant | str | None:
        if self._idcode not in (None, frame.idcode):
            raise FrameError(f"IDCODE: {frame.idcode} given; allowed: {self._idcode} (6.2)")
        if frame.kind == "header":
            return frame.body.decode(errors="replace")
        if frame.kind == "data":
            return self._instant(frame)
        if frame.kind == "command":
            raise FrameError("CMD: a command from a server; allowed: data, headers, configurations (6.6)")
        bodies = [frame.body]
        if frame.kind == "configuration_3":
            self.parts = bodies = self._part(frame.body)
            if not configuration.whole(bodies):
                return None
            self.parts = []
        made = configuration.decode(bodies, frame.kind)
        if frame.kind == "configuration_1":  # it has the available channels, not those sent
            return None
        self.layout, self.changed = data.layout(made), False
        self._announced, self._known = self._announced and made == self._known, made
        return made

    def _part(self, body: bytes) -> list[bytes]:
        """The parts of a configuration 3 so far; empty if one is out of order or there are too many."""
        index, before = int.from_bytes(body[:2], "big"), self.parts
        self.parts = []
        if index <= configuration.FIRST:
            return [body]
        if index not in (len(before) + 1, configuration.LAST) or len(before) >= MAX_PARTS:
            raise FrameError(f"CONT_IDX: {index} given; allowed: {len(before) + 1} to {MAX_PARTS}, or the last (6.4)")
        return [*before, body]

    def _instant(self, frame: Frame) -> Instant | None:
        """The content of a data frame; None while the configuration is unknown or outdated."""
        if self.layout is None or self._known is None:
            return None
        try:
            found = data.decode(self.layout, frame.body)
        except FrameError:
            self.changed = True
            raise
        announced = bool((found.status & CHANGE).any())
        over, self._announced = self._announced and not announced, announced
        self.changed = self.changed or announced or over
        if over:
            self.layout = None  # the configuration is another one from this frame on
            return None
        return Instant(frame.soc, frame.fraction * TIME_BASE // self._known.time_base, frame.quality, found)
