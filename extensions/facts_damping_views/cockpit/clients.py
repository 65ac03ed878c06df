"""What waits for a page of a cockpit, and the values that it gets when it is opened."""

from __future__ import annotations

import asyncio
import struct
from collections import deque

QUEUE = 256  # messages other than frames that wait for a client
FULL, THINNED = 900, 900  # most values of a history: the newest, and older ones, of which ever fewer stay


class Client:
    """A connected page: its waiting messages, and counts of what it did not get."""

    def __init__(self) -> None:
        self.frame: bytes | None = None
        self.texts: deque[str | bytes] = deque(maxlen=QUEUE)
        self.there = asyncio.Event()
        self.frames_left_out = self.texts_left_out = self.pending = 0

    def put_frame(self, data: bytes) -> None:
        """Keep a frame, in place of one that waits."""
        self.frames_left_out += self.frame is not None
        self.frame = data
        self.there.set()

    def put_text(self, text: str | bytes) -> None:
        """Queue a message, also earlier values; if there is no room, the oldest is dropped."""
        self.texts_left_out += len(self.texts) == QUEUE
        self.texts.append(text)
        self.there.set()

    async def next(self) -> str | bytes:
        """The next message: texts in order, then the frame."""
        while not self.texts and self.frame is None:
            self.there.clear()
            await self.there.wait()
        if self.texts:
            return self.texts.popleft()
        frame, self.frame = self.frame, None
        return frame or b""


class History:
    """Values over time as they were sent: the newest in full, older ones apart by a time that grows with the run."""

    def __init__(self) -> None:
        self._newest, self._older, self._apart_s = deque[bytes](), list[bytes](), 0.0

    def __len__(self) -> int:
        """Number of times."""
        return len(self._older) + len(self._newest)

    def append(self, data: bytes) -> None:
        """Take the newest values, of which the first is the time in Float32."""
        self._newest.append(data)
        if len(self._newest) > FULL:
            self._keep(self._newest.popleft())
        if len(self._older) == 2 * THINNED:
            self._apart_s = (_time_s(self._older[-1]) - _time_s(self._older[0])) / THINNED
            before, self._older = self._older, []
            for older in before:
                self._keep(older)

    def _keep(self, data: bytes) -> None:
        if not self._older or _time_s(data) - _time_s(self._older[-1]) >= self._apart_s:
            self._older.append(data)

    def all(self) -> bytes:
        """All of them, one after the other."""
        return b"".join((*self._older, *self._newest))


def _time_s(data: bytes) -> float:
    return float(struct.unpack_from("<f", data)[0])
