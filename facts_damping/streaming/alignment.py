"""Time alignment, as concentrators do it: what stations say of the same instant, put together."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


class StationReport(NamedTuple):
    """What some stations say of an instant."""

    where: NDArray[np.int64]  # their places
    values: NDArray[np.float64]  # (where, CHANNELS)
    status: NDArray[np.int64]  # (where,)
    absent: NDArray[np.bool_] | None = None  # (where,): of whom it is said that they are; none: nobody


class AlignedFrame(NamedTuple):
    """What stations said of an instant."""

    instant: int  # number of the frame since time began
    values: NDArray[np.float64]  # (stations, CHANNELS); NaN: nothing
    status: NDArray[np.int64]  # (stations,)
    there: NDArray[np.bool_]  # (stations,): who has said something
    heard: NDArray[np.bool_]  # (stations,): of whom something came, be it that they are absent


class Alignment:
    """Instants in their order: each when all stations that are `awaited` were heard, or when its time is over.

    Where one is missing, those after it wait until its time is over: it may have been overtaken.
    """

    def __init__(self, stations: int) -> None:
        """All of so many stations are awaited at first."""
        self.awaited, self.late = np.ones(stations, bool), 0  # entries that came when their instant had been given
        self._open: dict[int, AlignedFrame] = {}
        self._given: int | None = None  # the newest instant that is over

    def put(self, instant: int, said: StationReport) -> bool:
        """Take what is said of an instant; whether it was in time."""
        if self._given is not None and instant <= self._given:
            self.late += len(said.where)
            return False
        if instant not in self._open:
            n = len(self.awaited)
            empty = np.full((n, len(CHANNELS)), np.nan), np.zeros(n, np.int64), np.zeros(n, bool), np.zeros(n, bool)
            self._open[instant] = AlignedFrame(instant, *empty)
        one, where = self._open[instant], said.where
        one.values[where], one.status[where], one.heard[where] = said.values, said.status, True
        one.there[where] = True if said.absent is None else ~said.absent
        return True

    def take(self, over: int | None = None) -> Iterator[AlignedFrame]:
        """The instants that are due; `over`: the newest one that waits no longer."""
        for instant in sorted(self._open):
            one = self._open[instant]
            follows = self._given is None or instant == self._given + 1
            whole = follows and one.heard[self.awaited].all()
            if not whole and (over is None or instant > over):
                break
            self._given = instant
            yield self._open.pop(instant)
        if over is not None and self._given is not None:
            self._given = max(self._given, over)

    def forget(self) -> None:
        """Begin anew: instants may be any."""
        self._open.clear()
        self._given = None
