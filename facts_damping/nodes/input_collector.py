"""Collects the messages of several nodes by tick, so that their order of arrival cannot change a result."""

from __future__ import annotations

import time
from functools import partial
from typing import TYPE_CHECKING, Any

from facts_damping.errors import RunError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from facts_damping.nodes.base.parameters import Options
    from facts_damping.nodes.base.spinner import Spinner

AWAITED = 3  # ticks: paced by the clock, a sender silent for longer is not waited for until it sends again
PATIENCE = 0.9  # fraction of the time-out: more than UnitDelay's, less than that of nodes waiting for this one


class InputCollector:
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
        self._options, self._senders, self._step = options, dict(senders), step
        self._parts: dict[str, list[tuple[int, Any]]] = {name: [] for name in senders}
        self._newest = dict.fromkeys(senders, -1)
        self.heard = dict.fromkeys(senders, -1)  # tick of the newest used message, by part
        self._frames: list[tuple[int, Any]] = []
        self._received_at = time.monotonic()

    def store(self, part: str) -> Callable[..., None]:
        """Callback for the messages of a part."""
        return partial(self._store, part)

    def _store(self, part: str, tick: int, content: Any) -> None:
        self._parts[part].append((tick, content))
        self._newest[part], self._received_at = tick, time.monotonic()
        self._proceed()

    def frames(self, tick: int, content: Any) -> None:
        """Take the frames of a tick."""
        if self._options.paced and self._frames:
            self._go_on()  # without the parts that are late
        self._frames.append((tick, content))
        self._received_at = time.monotonic()
        self._proceed()

    def _proceed(self) -> None:
        while self._frames and all(self._done(newest, self._frames[0][0]) for newest in self._newest.values()):
            self._go_on()

    def _done(self, newest: int, tick: int) -> bool:
        """Whether a sender with tick `newest` has sent its message of `tick` or is not waited for."""
        return newest >= tick or (self._options.paced and newest < tick - AWAITED)

    def _go_on(self) -> None:
        tick, content = self._frames.pop(0)
        for name, told in self._parts.items():
            self.heard[name] = max([self.heard[name], *(at for at, _ in told if at <= tick)])
        parts = {name: [what for at, what in told if at <= tick] for name, told in self._parts.items()}
        self._parts = {name: [one for one in told if one[0] > tick] for name, told in self._parts.items()}
        self._step(tick, {"frames": content, **parts})

    def spin(self, spinner: Spinner, publishers: Mapping[str, Callable[[], int]]) -> None:
        """Spin until stopped. In lockstep, raises `RunError` naming senders that are silent while frames wait."""
        while True:
            spinner.spin_once(0.1)
            if not self._frames or self._options.paced:
                continue
            tick = self._frames[0][0]
            patience = PATIENCE * self._options.patience(tick)
            if time.monotonic() - self._received_at > patience:
                late = [name for name, newest in self._newest.items() if newest < tick]
                left = [name for name in late if publishers[name]() == 0]
                names = ", ".join(dict.fromkeys(self._senders[name] for name in left or late))
                what = "has left" if left else "is silent"
                raise RunError(f"{names} {what}: nothing of tick {tick} within {patience:g} s")
