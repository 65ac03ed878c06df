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
    from facts_damping.analysis.response import Swings, Twin
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
    first, last = grids(case)
    kind = MIRROR if first != last else WITHOUT_EVENTS  # the same for all controllers
    synchronous = bool(record.in_synchronism.all())
    other = twin(case, record, kind) if synchronous and case.scenario.events else None
    return measured_from(case, record, other, after)


def measured_from(case: Case, record: Record, other: Twin | None, after: float) -> Measured:
    """The figures of a run with its twin until `after` (s) the last event."""
    lost = None if record.in_synchronism.all() else float(record.time_s[-1])
    value, peak = (None, None) if lost is not None else _response(case, swings_of(record, other), after)
    effort = mean_effort(record) if record.device_names else 0.0
    duty = max(saturation_duty(record).values(), default=0.0)
    return Measured(value, peak, lost, effort, duty, bool(trips(supervision(record, None))))


def _response(case: Case, swings: Swings, after: float) -> tuple[float, float]:
    """Index and peak of a run in synchronism."""
    times = [event.time for event in case.scenario.events]
    t, x = swings.time_s[: len(swings.judged)], swings.judged
    if not times:
        x = x[t >= SETTLED]
        return float(np.sqrt(np.mean(np.square(x)))), float(np.abs(x).max())
    inside = (t >= min(times)) & (t <= max(times) + after)
    return performance_indices(t[inside], x[inside], min(times))["ITAE"], float(np.abs(x[inside]).max())
