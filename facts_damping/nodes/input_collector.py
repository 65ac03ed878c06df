"""What several others say of a tick, put together: nobody's order of speaking changes a result."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.base.spinner import Spinner

AWAITED = 3  # ticks: by the clock, who has said nothing for longer is not waited for until it speaks again
PATIENCE = 0.9  # share of the time-out: after those who wait for others, before those who wait for this node


class InputCollector:
    """Ticks in turn: in lockstep when all have spoken; by the clock at the latest when the next frames come.

    That is a tick late. By the clock nobody waits for who is silent by now: what stands in for it is in time.
    """

    def __init__(
        self, options: Options, senders: Mapping[str, str], step: Callable[[int, dict[str, Any]], None]
    ) -> None:
        """`senders`: who says each part; `step(tick, parts)`: called for each tick, with what has come by then.

        Of a part that comes again before it is used, which in real time may be, all is there, in a list.
        """
        self._options, self._senders, self._step = options, dict(senders), step
        self._parts: dict[str, list[tuple[int, Any]]] = {name: [] for name in senders}
        self._newest = dict.fromkeys(senders, -1)
        self.heard = dict.fromkeys(senders, -1)  # tick of the newest message of each that is used
        self._frames: list[tuple[int, Any]] = []
        self._heard = time.monotonic()

    def taking(self, part: str) -> Callable[..., None]:
        """What takes the messages of a part."""
        return partial(self._take, part)

    def _take(self, part: str, tick: int, content: Any) -> None:
        self._parts[part].append((tick, content))
        self._newest[part], self._heard = tick, time.monotonic()
        self._proceed()

    def frames(self, tick: int, content: Any) -> None:
        """The frames of a tick."""
        if self._options.paced and self._frames:
            self._go_on()  # who is late is late
        self._frames.append((tick, content))
        self._heard = time.monotonic()
        self._proceed()

    def _proceed(self) -> None:
        while self._frames and all(self._done(newest, self._frames[0][0]) for newest in self._newest.values()):
            self._go_on()

    def _done(self, newest: int, tick: int) -> bool:
        """Whether a sender, whose newest tick is given, has spoken in a tick, or is not waited for."""
        return newest >= tick or (self._options.paced and newest < tick - AWAITED)

    def _go_on(self) -> None:
        tick, content = self._frames.pop(0)
        for name, told in self._parts.items():
            self.heard[name] = max([self.heard[name], *(at for at, _ in told if at <= tick)])
        parts = {name: [what for at, what in told if at <= tick] for name, told in self._parts.items()}
        self._parts = {name: [one for one in told if one[0] > tick] for name, told in self._parts.items()}
        self._step(tick, {"frames": content, **parts})

    def spin(self, spinner: Spinner, publishers: Mapping[str, Callable[[], int]]) -> None:
        """Spin until stopped. Raises `RunError` naming who, in lockstep, is silent or has left while frames wait."""
        while True:
            spinner.spin_once(0.1)
            if not self._frames or self._options.paced:
                continue
            tick = self._frames[0][0]
            patience = PATIENCE * self._options.patience(tick)
            if time.monotonic() - self._heard > patience:
                late = [name for name, newest in self._newest.items() if newest < tick]
                left = [name for name in late if publishers[name]() == 0]
                who = ", ".join(dict.fromkeys(self._senders[name] for name in left or late))
                what = "has left" if left else "is silent"
                raise RunError(f"{who} {what}: nothing of tick {tick} within {patience:g} s")
