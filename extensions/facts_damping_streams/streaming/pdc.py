"""Converts a run's PMU reports, tick by tick, to instants of a stream: as reported, or as delivered by a link."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.measurement.pmu_model import UNSYNCHRONISED
from facts_damping.signals import NANOSECONDS
from facts_damping_streams.c37118 import stat, system_pmus
from facts_damping_streams.c37118.configuration import TIME_BASE
from facts_damping_streams.c37118.session import Instant
from facts_damping_streams.c37118.system_pmus import Pmu
from facts_damping_streams.streaming.stream_clock import Alignment, PmuReport

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.compiling.structs import Float1
    from facts_damping.parameters.measurement import Measurement
    from facts_damping_streams.streaming.stream_clock import AlignedFrame

WAIT_S = 1.0  # s, longest wait of a delivered instant for the slowest PMU


def grid_pmus(case: Case) -> list[Pmu]:
    """A run's PMUs with the bases of their measurements."""
    kilovolts = {bus.name: bus.nominal_voltage for bus in case.system.buses}
    return [Pmu(name, kilovolts[bus], case.system.base_power) for name, bus in case.system.pmu_buses().items()]


class Pdc:
    """Emits instants in order, each stamped with its time of measurement; a PMU without values is absent.

    As reported, one tick is one instant: with wrong PMU clocks the stamp is the nearest frame, and the clock error
    appears in the angles. As delivered, an instant waits for the slowest PMU, but at most `wait_s`.
    """

    def __init__(self, case: Case, epoch_s: float, wait_s: float | None = None) -> None:
        """`epoch_s`: time of tick 0, s since 1970, rounded to a frame; `wait_s`: None for frames as reported."""
        self.grid, self._rate = grid_pmus(case), case.run.frame_rate
        self._first = round(epoch_s * self._rate)  # frame number of tick 0
        self._wait = None if wait_s is None else round(wait_s * self._rate)
        self.alignment = Alignment(len(self.grid))
        self._lost_ns, self._drift = _clocks(case.measurement, self.grid)

    def take(self, tick: int, rows: NDArray[Any]) -> list[Instant]:
        """Instants that a tick's entries (DELIVERY) complete."""
        numbers = np.rint(rows["measured_ns"] * (self._rate / NANOSECONDS)).astype(np.int64)
        if self._wait is None:
            numbers[:] = np.sort(numbers)[len(numbers) // 2] if len(numbers) else 0
        for number in np.unique(numbers).tolist():
            entries = rows[numbers == number]
            self.alignment.put(number, PmuReport(entries["pmu"], entries["values"], entries["status"]))
        over = (int(numbers[0]) if len(numbers) else None) if self._wait is None else tick - self._wait
        return [self._instant(aligned) for aligned in self.alignment.take(over)]

    def rest(self) -> list[Instant]:
        """Instants that still wait for other PMUs."""
        return [self._instant(aligned) for aligned in self.alignment.take(sys.maxsize)]

    def _instant(self, aligned_frame: AlignedFrame) -> Instant:
        second, number = divmod(self._first + aligned_frame.instant, self._rate)
        unsynchronised = aligned_frame.there & ((aligned_frame.status & UNSYNCHRONISED) > 0)
        for_s = np.where(unsynchronised, aligned_frame.instant / self._rate - self._lost_ns / NANOSECONDS, 0.0).clip(
            0.0
        )
        error_s = self._drift * for_s
        words = stat.word(aligned_frame.status, aligned_frame.there, error_s, for_s)
        data, quality = (
            system_pmus.to_data(self.grid, aligned_frame.values, words),
            stat.message_quality(error_s[unsynchronised]),
        )
        return Instant(second, number * TIME_BASE // self._rate, quality, data)


def _clocks(measurement: Measurement, grid: Sequence[Pmu]) -> tuple[Float1, Float1]:
    """Time at which each PMU's clock loses synchronism, ns, and its drift from then on, s/s."""
    errors = [measurement.pmus.get(pmu.name) for pmu in grid]
    clocks = [measurement.clock if error is None or error.clock is None else error.clock for error in errors]
    lost = [NANOSECONDS * (0.0 if clock.lost is None else clock.lost) for clock in clocks]
    return np.array(lost), np.array([abs(clock.drift) for clock in clocks])
