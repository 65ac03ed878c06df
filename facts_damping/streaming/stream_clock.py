"""Streams as the ticks of a run: which tick an instant is, what is there in it, and when it is over without.

A tick is a frame's instant. It is due when its frame comes at the earliest, by this computer's clock: so late as the
quickest frames of late have come. It waits for all stations that streams have, but a given time at most; then what is
missing is missing. So ticks go on, empty, while nothing comes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.streaming.alignment import AlignedFrame, Alignment, StationReport

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from facts_damping.c37118.configuration import Configuration

LEAK = 1e-3  # share by which the two clocks may drift apart
OFF_S = 1.0  # stamps that have been out of time for so long are of another time
JUMP_S = 10.0  # stamps that are further ahead of this computer's clock than they were are of another time


class Tick(NamedTuple):
    """A tick that is over."""

    number: int
    said: AlignedFrame | None  # none: nothing has come


class Following:
    """Ticks from instants, as they come."""

    def __init__(self, stations: int, rate: int, wait_s: float) -> None:
        self.alignment, self.ahead = Alignment(stations), 0  # ticks by which time is ahead of the stamps
        self.first: int | None = None  # instant of tick 0
        self.next, self.moved = 0, 0  # the next tick; how often stamps have been taken for those of another time
        self._rate, self._wait_s = rate, wait_s
        self._due_s = math.inf  # when tick 0 was due, by this computer's clock
        self._least_s = -math.inf  # it was not due before
        self._off_s = math.inf  # since when all instants have been out of time

    def put(self, instant: int, said: StationReport, now_s: float) -> None:
        """Take what is said of an instant."""
        if self.first is None:
            self._begin(instant, now_s)
        begun_s = now_s - self.tick(instant) / self._rate
        if begun_s < self._least_s or not self.alignment.put(instant, said):
            self._off_s = min(self._off_s, now_s)
            if now_s - self._off_s > OFF_S:
                self.moved += 1
                self._begin(instant, now_s)
            return
        self._off_s = math.inf
        self._due_s = min(self._due_s + LEAK / self._rate, begun_s)
        self._least_s = max(self._least_s - LEAK / self._rate, self._due_s - JUMP_S)

    def _begin(self, instant: int, now_s: float) -> None:
        """Take an instant for now: the first one, or a source was put back, stopped for a while, or is another one."""
        self.alignment.forget()
        self.first, self._off_s = instant - max(0, self.next - self.ahead), math.inf
        self._due_s = now_s - self.tick(instant) / self._rate
        self._least_s = self._due_s - JUMP_S

    def tick(self, instant: int) -> int:
        """The tick of an instant."""
        return instant - (self.first or 0) + self.ahead

    def take(self, now_s: float) -> Iterator[Tick]:
        """The ticks that are over, one after the other, none left out."""
        if self.first is None:
            return
        over = math.floor((now_s - self._due_s - self._wait_s) * self._rate)
        for one in self.alignment.take(over + self.first - self.ahead):
            yield from self._empty(self.tick(one.instant))
            yield Tick(self.next, one)
            self.next += 1
        yield from self._empty(over + 1)

    def _empty(self, until: int) -> Iterator[Tick]:
        while self.next < until:
            yield Tick(self.next, None)
            self.next += 1

    def left_s(self, now_s: float) -> float:
        """Time until the next tick is over at the latest, s."""
        return max(0.0, self._due_s + self.next / self._rate + self._wait_s - now_s)


def latency(known: Sequence[Configuration], rate: int) -> int:
    """Ticks that frames come after the instant that they describe, by the group delay that configuration 3 tells."""
    longest = max((pmu.site.group_delay_us for c in known for pmu in c.pmus), default=0)
    return math.ceil(longest * rate / 1e6 - 1e-3)
