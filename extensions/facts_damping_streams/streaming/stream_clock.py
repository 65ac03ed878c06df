"""Time alignment, as in a phasor data concentrator, and ticks of a run from the instants of streams.

One tick is one frame instant. It is due, by this computer's clock, at the earliest time its frame can arrive: the
delay of the quickest recent frames. It then waits for all PMUs of the streams, but at most a given time; data that
are still missing stay missing. So ticks continue, empty, while nothing arrives.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Bool1, Float2, Int1
    from facts_damping_streams.c37118.configuration import Configuration


class PmuReport(NamedTuple):
    """Reports of some PMUs for one instant."""

    where: NDArray[np.int64]  # indices of the PMUs
    values: Float2  # (where, CHANNELS)
    status: Int1  # (where,)
    absent: NDArray[np.bool_] | None = None  # (where,): PMUs reported as absent; None: none


class AlignedFrame(NamedTuple):
    """Combined reports of all PMUs for one instant."""

    instant: int  # frame number since the epoch of the stamps
    values: Float2  # (PMUs, CHANNELS); NaN: no value
    status: Int1  # (PMUs,)
    there: Bool1  # (PMUs,): has values
    reported: Bool1  # (PMUs,): has reported, be it values or absence


class Alignment:
    """Emits instants in order: each when all `awaited` PMUs have reported, or when its time is over.

    If an instant is missing, later ones wait until its time is over, since frames may overtake each other.
    """

    def __init__(self, pmus: int) -> None:
        """Await all of `pmus` PMUs at first."""
        self.awaited, self.late = np.ones(pmus, bool), 0  # entries that arrived after their instant was emitted
        self._open: dict[int, AlignedFrame] = {}
        self._given: int | None = None  # the newest instant emitted or over

    def put(self, instant: int, report: PmuReport) -> bool:
        """Add a report of an instant. Returns whether it was in time."""
        if self._given is not None and instant <= self._given:
            self.late += len(report.where)
            return False
        if instant not in self._open:
            n = len(self.awaited)
            empty = np.full((n, len(CHANNELS)), np.nan), np.zeros(n, np.int64), np.zeros(n, bool), np.zeros(n, bool)
            self._open[instant] = AlignedFrame(instant, *empty)
        frame, where = self._open[instant], report.where
        frame.values[where], frame.status[where], frame.reported[where] = report.values, report.status, True
        frame.there[where] = True if report.absent is None else ~report.absent
        return True

    def take(self, over: int | None = None) -> Iterator[AlignedFrame]:
        """Instants that are complete or over; `over`: the newest one whose time is over."""
        for instant in sorted(self._open):
            frame = self._open[instant]
            follows = self._given is None or instant == self._given + 1
            whole = follows and frame.reported[self.awaited].all()
            if not whole and (over is None or instant > over):
                break
            self._given = instant
            yield self._open.pop(instant)
        if over is not None and self._given is not None:
            self._given = max(self._given, over)

    def forget(self) -> None:
        """Reset: the next instant may have any number."""
        self._open.clear()
        self._given = None


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
        if begun_s < self._min_s or not self._put(instant, report):
            self._off_s = min(self._off_s, now_s)
            if now_s - self._off_s > OFF_S:
                self.moved += 1
                self._begin(instant, now_s)
            return
        self._off_s = math.inf
        self._due_s = min(self._due_s + LEAK / self._rate, begun_s)
        self._min_s = max(self._min_s - LEAK / self._rate, self._due_s - JUMP_S)

    def _put(self, instant: int, report: PmuReport) -> bool:
        """Add a report unless its tick is over, which the alignment does not know after a change of the time base."""
        if self.tick(instant) < self.next:
            self.alignment.late += len(report.where)
            return False
        return self.alignment.put(instant, report)

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
        for frame in self.alignment.take(over + self.first - self.ahead):
            yield from self._empty(self.tick(frame.instant))
            yield Tick(self.next, frame)
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
