"""Time alignment, as in a phasor data concentrator: combines the PMUs' reports of the same instant."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Bool1, Float2, Int1


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
        one, where = self._open[instant], report.where
        one.values[where], one.status[where], one.reported[where] = report.values, report.status, True
        one.there[where] = True if report.absent is None else ~report.absent
        return True

    def take(self, over: int | None = None) -> Iterator[AlignedFrame]:
        """Instants that are complete or over; `over`: the newest one whose time is over."""
        for instant in sorted(self._open):
            one = self._open[instant]
            follows = self._given is None or instant == self._given + 1
            whole = follows and one.reported[self.awaited].all()
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
