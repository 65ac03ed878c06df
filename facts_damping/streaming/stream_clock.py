"""Converts streams to ticks of a run: assigns instants to ticks and decides when a tick is over.

One tick is one frame instant. It is due, by this computer's clock, at the earliest time its frame can arrive: the
delay of the quickest recent frames. It then waits for all PMUs of the streams, but at most a given time; data that
are still missing stay missing. So ticks continue, empty, while nothing arrives.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.streaming.alignment import AlignedFrame, Alignment, PmuReport

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from facts_damping.c37118.configuration import Configuration

LEAK = 1e-3  # largest relative drift between the two clocks
OFF_S = 1.0  # s; stamps that stay out of range for longer belong to another time base
JUMP_S = 10.0  # s; stamps that jump further ahead of this computer's clock belong to another time base


class Tick(NamedTuple):
    """A tick that is over."""

    number: int
    frame: AlignedFrame | None  # None: nothing arrived


class Following:
    """Converts arriving instants to ticks."""

    def __init__(self, pmus: int, rate: int, wait_s: float) -> None:
        self.alignment, self.ahead = Alignment(pmus), 0  # ticks by which the run's time is ahead of the stamps
        self.first: int | None = None  # instant of tick 0
        self.next, self.moved = 0, 0  # the next tick; number of changes of the time base
        self._rate, self._wait_s = rate, wait_s
        self._due_s = math.inf  # when tick 0 was due, by this computer's clock
        self._min_s = -math.inf  # earliest plausible value of `_due_s`
        self._off_s = math.inf  # since when all instants have been out of range

    def put(self, instant: int, report: PmuReport, now_s: float) -> None:
        """Add a report of an instant."""
        if self.first is None:
            self._begin(instant, now_s)
        begun_s = now_s - self.tick(instant) / self._rate
        if begun_s < self._min_s or not self.alignment.put(instant, report):
            self._off_s = min(self._off_s, now_s)
            if now_s - self._off_s > OFF_S:
                self.moved += 1
                self._begin(instant, now_s)
            return
        self._off_s = math.inf
        self._due_s = min(self._due_s + LEAK / self._rate, begun_s)
        self._min_s = max(self._min_s - LEAK / self._rate, self._due_s - JUMP_S)

    def _begin(self, instant: int, now_s: float) -> None:
        """Take an instant as the present: the first one, or after the source changed, paused or was set back."""
        self.alignment.forget()
        self.first, self._off_s = instant - max(0, self.next - self.ahead), math.inf
        self._due_s = now_s - self.tick(instant) / self._rate
        self._min_s = self._due_s - JUMP_S

    def tick(self, instant: int) -> int:
        """Tick of an instant."""
        return instant - (self.first or 0) + self.ahead

    def take(self, now_s: float) -> Iterator[Tick]:
        """The ticks that are over, in order and without gaps."""
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
        """Longest time until the next tick is over, s."""
        return max(0.0, self._due_s + self.next / self._rate + self._wait_s - now_s)


def latency(known: Sequence[Configuration], rate: int) -> int:
    """Ticks by which frames lag the instants they describe, by the group delay in configuration 3."""
    longest = max((pmu.site.group_delay_us for c in known for pmu in c.pmus), default=0)
    return math.ceil(longest * rate / 1e6 - 1e-3)
