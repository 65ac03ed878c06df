"""Collects the messages of several nodes by tick, so that their order of arrival cannot change a result."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus

from facts_damping.errors import RunError
from facts_damping.nodes import clock
from facts_damping.nodes.transport.messages import Health

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.base.spinner import Spinner

AWAITED = 3  # ticks: paced by the clock, a sender silent for longer is not waited for until it sends again
# Fractions of the time-out: a waiting node names the silent one before others name the waiting node.
DELAY_PATIENCE, COLLECTOR_PATIENCE = 0.8, 0.9


class _Frames:
    """Frames that wait for the messages of other nodes."""

    def __init__(self, options: Options) -> None:
        self._options, self._received_at = options, clock.monotonic()
        self._frames: list[tuple[int, Any]] = []

    def frames(self, tick: int, content: Any) -> None:
        """Take the frames of a tick."""
        self._frames.append((tick, content))
        self._received_at = clock.monotonic()
        self._proceed()

    def _proceed(self) -> None:
        """Process the ticks that have all their messages."""
        raise NotImplementedError

    def _wait(self, spinner: Spinner, fraction: float) -> tuple[int, float]:
        """Spin until frames have waited too long. Returns their tick and for how many seconds they may wait."""
        while True:
            spinner.spin_once(0.1)
            if self._frames:
                patience = fraction * self._options.patience(self._frames[0][0])
                if clock.monotonic() - self._received_at > patience:
                    return self._frames[0][0], patience


class UnitDelay(_Frames):
    """Pairs the frames of a tick with a sender's messages of earlier ticks; in lockstep, frames wait for them."""

    def __init__(
        self, options: Options, frame_rate: int, sender: str, step: Callable[[int, Any, list[Any]], None]
    ) -> None:
        """`step(tick, frames, messages)` is called for each tick; `sender`: node that it waits for, or empty."""
        super().__init__(options)
        self._waits, self._sender, self._step = bool(sender) and not options.paced, sender, step
        self._messages: list[tuple[int, Any]] = []
        self._newest = self.latest = -1  # tick of the newest message; of the newest used message
        self._rate, self._tick, self._arrived = frame_rate, -1, -1  # current tick; newest tick with an entry

    def receive(self, tick: int, content: Any) -> None:
        """Take a message of the sender."""
        self._messages.append((tick, content))
        self._newest, self._received_at = max(self._newest, tick), clock.monotonic()
        self._proceed()

    def _proceed(self) -> None:
        while self._frames and (not self._waits or self._newest >= self._frames[0][0] - 1):
            tick, frames = self._frames.pop(0)
            self._tick, self._arrived = tick, tick if len(frames) else self._arrived
            self.latest = max([self.latest, *(at for at, _ in self._messages if at < tick)])
            due = [content for at, content in self._messages if at < tick]
            self._messages = [(at, content) for at, content in self._messages if at >= tick]
            self._step(tick, frames, due)

    def health(self, text: str, **more: str) -> Health:
        """Whether frames arrive; `text`: message if they do; `more`: further values."""
        values = {"mode": self._options.mode, **more, "tick": self._tick}
        if self._tick - self._arrived > self._rate:
            return Health(DiagnosticStatus.WARN, "no frame has arrived for a second", values)
        return Health(DiagnosticStatus.OK, text, values)

    def spin(self, spinner: Spinner) -> None:
        """Spin until stopped. Raises `RunError` naming the sender if it is silent while frames wait."""
        tick, patience = self._wait(spinner, DELAY_PATIENCE)
        raise RunError(f"{self._sender} is silent: nothing of tick {tick - 1} within {patience:g} s")


class InputCollector(_Frames):
    """Calls a step for each tick in turn: in lockstep when all parts are there; else at latest with the next frames.

    A step forced by the next frames is one tick late. Paced by the clock, a sender silent for more than `AWAITED` ticks
    is not waited for, so that its fallback acts in time.
    """

    def __init__(
        self, options: Options, senders: Mapping[str, str], step: Callable[[int, dict[str, Any]], None]
    ) -> None:
        """`senders`: node name by part; `step(tick, parts)`: called for each tick with the parts that have come.

        Each part except the frames is a list, as in real time several messages may come before it is used.
        """
        super().__init__(options)
        self._senders, self._step = dict(senders), step
        self._parts: dict[str, list[tuple[int, Any]]] = {name: [] for name in senders}
        self._newest = dict.fromkeys(senders, -1)
        self.latest = dict.fromkeys(senders, -1)  # tick of the newest used message, by part

    def store(self, part: str) -> Callable[..., None]:
        """Callback for the messages of a part."""
        return partial(self._store, part)

    def _store(self, part: str, tick: int, content: Any) -> None:
        self._parts[part].append((tick, content))
        self._newest[part], self._received_at = tick, clock.monotonic()
        self._proceed()

    def frames(self, tick: int, content: Any) -> None:
        """Take the frames of a tick."""
        if self._options.paced and self._frames:
            self._call_step()  # without the parts that are late
        super().frames(tick, content)

    def _proceed(self) -> None:
        while self._frames and all(self._done(newest, self._frames[0][0]) for newest in self._newest.values()):
            self._call_step()

    def _done(self, newest: int, tick: int) -> bool:
        """Whether a sender with tick `newest` has sent its message of `tick` or is not waited for."""
        return newest >= tick or (self._options.paced and newest < tick - AWAITED)

    def _call_step(self) -> None:
        tick, frames = self._frames.pop(0)
        parts: dict[str, Any] = {"frames": frames}
        for name, messages in self._parts.items():
            self.latest[name] = max([self.latest[name], *(at for at, _ in messages if at <= tick)])
            parts[name] = [content for at, content in messages if at <= tick]
            self._parts[name] = [message for message in messages if message[0] > tick]
        self._step(tick, parts)

    def spin(self, spinner: Spinner, publishers: Mapping[str, Callable[[], int]]) -> None:
        """Spin until stopped. In lockstep, raises `RunError` naming senders that are silent while frames wait."""
        while True:
            tick, patience = self._wait(spinner, COLLECTOR_PATIENCE)
            if not self._options.paced:
                break
        late = [name for name, newest in self._newest.items() if newest < tick]
        left = [name for name in late if publishers[name]() == 0]
        names = ", ".join(dict.fromkeys(self._senders[name] for name in left or late))
        raise RunError(f"{names} {'has left' if left else 'is silent'}: nothing of tick {tick} within {patience:g} s")
