"""What is measured of a controller in a case.

The measure is ITAE (4.108) of the response to the events (analysis/response.py) from the first event to some seconds
after the last. Without an event it is the root mean square of the speed differences. Both are compared with those of
the same case without control.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.effort import saturation_duty
from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.response import MIRROR, WITHOUT_EVENTS, swings_of
from facts_damping.analysis.supervision import supervision, trips
from facts_damping.simulation import loop
from facts_damping.simulation.twins import grids, twin
from facts_damping_studies.search.scoring import mean_effort

if TYPE_CHECKING:
    from facts_damping.case.model import Case
    from facts_damping.record import Record

SETTLED = 5.0  # s of noise that do not count


class Measured(NamedTuple):
    """Figures of a controller in a case."""

    measure: float | None  # ITAE of the response, p.u. s^2, or rms, p.u.; None: synchronism is lost
    peak: float | None  # p.u., largest speed difference of the response after the event
    lost_s: float | None  # s, when synchronism is lost
    effort: float  # mean of the setpoints relative to their limits
    saturated: float  # fraction of the time at a limit, of the device that is longest
    tripped: bool  # whether a supervisor took it off


def measure(case: Case, after: float) -> Measured:
    """Simulate a case with its twin, and measure the response until `after` (s) the last event."""
    record = loop.run(case)
    lost = None if record.in_synchronism.all() else float(record.time_s[-1])
    value, peak = (None, None) if lost is not None else _response(case, record, after)
    effort = mean_effort(record) if case.controllers else 0.0
    duty = max(saturation_duty(record).values(), default=0.0)
    return Measured(value, peak, lost, effort, duty, bool(trips(supervision(record, None))))


def _response(case: Case, record: Record, after: float) -> tuple[float, float]:
    """Index and peak of a run in synchronism."""
    times = [event.time for event in case.scenario.events]
    first, last = grids(case)
    kind = MIRROR if first != last else WITHOUT_EVENTS  # the same for all controllers
    swings = swings_of(record, twin(case, record, kind) if times else None)
    t, x = record.time_s[: len(swings.judged)], swings.judged
    if not times:
        x = x[t >= SETTLED]
        return float(np.sqrt(np.mean(np.square(x)))), float(np.abs(x).max())
    inside = (t >= min(times)) & (t <= max(times) + after)
    return performance_indices(t[inside], x[inside], min(times))["ITAE"], float(np.abs(x[inside]).max())
