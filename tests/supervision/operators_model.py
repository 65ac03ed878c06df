"""A second model of a supervisor's states, as its description has them: plain Python, slow, by other means.

A supervisor begins in shadow. What an operator asks for acts at the start of a tick; a schedule arms by itself. What
monitors see counts from the end of a tick on. A monitor acts once its value was beyond its limit at the end of every
tick of a time. Armed: a monitor that trips goes before one that falls back; without a fallback that has just spoken,
falling back is a trip. In the fallback: what trips, trips; when data have been sound for the time of recovery, the
controller is given back. Tripped: an operator's alone to leave, by way of shadow.
"""

from __future__ import annotations

from typing import NamedTuple

from facts_damping.monitor_table import MONITORS

SEVERE = {"warn": 1, "fall_back": 2, "trip": 3}


class Settings(NamedTuple):
    """What the model is given; times in s."""

    follows: dict[str, str]
    limit: dict[str, float]
    lasts: dict[str, float]
    recovery: float
    arm_at: float | None
    patience: float  # with a fallback


class Model:
    """One supervisor."""

    def __init__(self, settings: Settings) -> None:
        self.given, self.state, self.why, self.refused = settings, "shadow", "", ""
        self.history: list[set[str]] = []  # monitors beyond their limits at the ends of ticks
        self.ends: list[float] = []
        self.entered = self.latest = float("-inf")
        self.scheduled = False

    def ask(self, command: str | None, start: float) -> None:
        """The start of a tick."""
        due = self.given.arm_at is not None and start >= self.given.arm_at and not self.scheduled
        if due:
            self.scheduled = True
            self._arm("schedule", start)
        if command == "arm":
            self._arm("operator", start)
        elif command == "disarm":
            self._enter("disarmed", "operator", start)
        elif command == "reset" and self.state in ("tripped", "disarmed"):
            self._enter("shadow", "operator", start)

    def see(self, values: dict[str, float], reserve: float | None, end: float) -> None:
        """The end of a tick; `reserve`: when the fallback spoke in it."""
        g = self.given
        self.latest = self.latest if reserve is None else reserve
        self.history.append({m for m in g.follows if values[m] > g.limit[m]})
        self.ends.append(end)
        acting = [m for m in MONITORS if m in g.follows and self._lasts(m)]
        trips = [m for m in acting if g.follows[m] == "trip"]
        falls = [m for m in acting if g.follows[m] == "fall_back"]
        if self.state == "armed" and trips:
            self._enter("tripped", trips[0], end)
        elif self.state == "armed" and falls:
            there = end - self.latest <= g.patience
            self._enter("fallback" if there else "tripped", falls[0], end)
        elif self.state == "fallback" and trips:
            self._enter("tripped", trips[0], end)
        elif self.state == "fallback" and end - max(self.entered, self._last_unsound()) >= g.recovery:
            self._enter("armed", self.why, end)

    def _lasts(self, monitor: str) -> bool:
        """Whether it is beyond its limit now, and was at every end of a tick for as long as it takes."""
        k = len(self.history)
        while k > 0 and monitor in self.history[k - 1]:
            k -= 1
        return k < len(self.history) and self.ends[-1] - self.ends[k] >= self.given.lasts[monitor]

    def _last_unsound(self) -> float:
        bad = {m for m, what in self.given.follows.items() if what == "fall_back"}
        times = [end for end, beyond in zip(self.ends, self.history, strict=True) if beyond & bad]
        return times[-1] if times else float("-inf")

    def _arm(self, by: str, start: float) -> None:
        severe = [m for m in MONITORS if m in self.given.follows and SEVERE[self.given.follows[m]] > 1]
        severe = [m for m in severe if self._lasts(m)]  # what would trip it, or have it fall back
        self.refused = "not in shadow" if self.state != "shadow" else severe[0] if severe else ""
        if not self.refused:
            self._enter("armed", by, start)

    def _enter(self, state: str, why: str, at: float) -> None:
        self.state, self.why, self.entered = state, why, at
