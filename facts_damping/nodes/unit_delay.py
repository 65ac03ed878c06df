"""Delays the messages of one sender by one tick, so that the order of arrival cannot change a result."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus

from facts_damping.errors import RunError
from facts_damping.nodes.transport.messages import Health

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.base.spinner import Spinner

PATIENCE = 0.8  # fraction of the time-out: a waiting node names the silent one before others name the waiting node


class UnitDelay:
    """Pairs the frames of a tick with the sender's messages of earlier ticks; in lockstep, frames wait for them."""

    def __init__(
        self, options: Options, frame_rate: int, sender: str, step: Callable[[int, Any, list[Any]], None]
    ) -> None:
        """`step(tick, frames, messages)` is called for each tick; `sender`: node that it waits for, or empty."""
        self._waits = bool(sender) and not options.paced
        self._sender, self._step, self._options = sender, step, options
        self._waiting: list[tuple[int, Any]] = []
        self._frames: list[tuple[int, Any]] = []
        self._newest, self._received_at = -1, time.monotonic()
        self._rate, self._tick, self._arrived = frame_rate, -1, -1  # current tick; newest tick with an entry
        self.heard = -1  # tick of the newest message used

    def receive(self, tick: int, content: Any) -> None:
        """Take a message of the sender."""
        self._waiting.append((tick, content))
        self._newest, self._received_at = max(self._newest, tick), time.monotonic()
        self._proceed()

    def frames(self, tick: int, content: Any) -> None:
        """Take the frames of a tick."""
        self._frames.append((tick, content))
        self._received_at = time.monotonic()
        self._proceed()

    def _proceed(self) -> None:
        while self._frames and (not self._waits or self._newest >= self._frames[0][0] - 1):
            tick, content = self._frames.pop(0)
            self._tick, self._arrived = tick, tick if len(content) else self._arrived
            due = [message for at, message in self._waiting if at < tick]
            self.heard = max([self.heard, *(at for at, _ in self._waiting if at < tick)])
            self._waiting = [(at, message) for at, message in self._waiting if at >= tick]
            self._step(tick, content, due)

    def health(self, does: str, **more: str) -> Health:
        """Whether frames arrive; `does`: message if they do; `more`: further values."""
        values = {"mode": self._options.mode, **more, "tick": self._tick}
        if self._tick - self._arrived > self._rate:
            return Health(DiagnosticStatus.WARN, "no frame has arrived for a second", values)
        return Health(DiagnosticStatus.OK, does, values)

    def spin(self, spinner: Spinner) -> None:
        """Spin until stopped. Raises `RunError` naming the sender if it is silent while frames wait."""
        while True:
            spinner.spin_once(0.1)
            if not self._frames:
                continue
            tick = self._frames[0][0]
            patience = PATIENCE * self._options.patience(tick)
            if time.monotonic() - self._received_at > patience:
                raise RunError(f"{self._sender} is silent: nothing of tick {tick - 1} within {patience:g} s")
