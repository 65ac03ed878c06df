"""What waits for a page of a cockpit, and the values that it gets when it is opened."""

from __future__ import annotations

import asyncio
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


class History(list[bytes]):
    """Values over time as they were sent: the first, the newest in full, older ones thinned again and again."""

    def append(self, data: bytes) -> None:
        """Take the newest values."""
        super().append(data)
        if len(self) == FULL + 2 * THINNED:
            del self[1 : 2 * THINNED : 2]
