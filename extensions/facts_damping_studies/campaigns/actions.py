"""Actions of a supervisor during a run, from its record."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.monitor_table import ARMED, CODES, FALLBACK, NO_CAUSE, TRIPPED, cause_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record


class Actions(NamedTuple):
    """What a supervisor did: when, why, and how long after a fault's start; None: it did not."""

    armed_s: float | None = None
    fallback_s: float | None = None
    tripped_s: float | None = None
    cause: str | None = None  # monitor that tripped it
    fallback_cause: str | None = None
    not_armed: str | None = None  # monitor that kept it from being armed
    reversals: float = 0.0  # largest value of that monitor
    early: bool = False  # it acted before the fault
    detected_s: float | None = None  # from the fault to the first action after it


def doings(record: Record, start_s: float) -> Actions:
    """Actions of the first controller's supervisor in a run whose fault starts at a time, s."""
    statuses = record.supervision[record.supervision["controller"] == 0]
    time_s = (statuses["tick"] + 1) / record.frame_rate  # a verdict is available at the end of a tick
    first = {state: _first(statuses["state"] == state, time_s) for state in (ARMED, FALLBACK, TRIPPED)}
    tripped = statuses[statuses["state"] == TRIPPED]
    left = [t for t in (first[FALLBACK], first[TRIPPED]) if t is not None]
    after = [t - start_s for t in left if t >= start_s]
    fallen = statuses[statuses["state"] == FALLBACK]
    refused = statuses["refused"][statuses["refused"] != NO_CAUSE]
    return Actions(
        armed_s=first[ARMED],
        fallback_s=first[FALLBACK],
        tripped_s=first[TRIPPED],
        cause=cause_name(int(tripped["cause"][0])) if len(tripped) else None,
        fallback_cause=cause_name(int(fallen["cause"][0])) if len(fallen) else None,
        not_armed=cause_name(int(refused[0])) if len(refused) and first[ARMED] is None else None,
        reversals=float(statuses["values"][:, CODES["reversals"]].max(initial=0.0)),
        early=any(t < start_s for t in left),
        detected_s=min(after, default=None),
    )


def _first(which: NDArray[np.bool_], time_s: NDArray[np.float64]) -> float | None:
    at = np.flatnonzero(which)
    return float(time_s[at[0]]) if len(at) else None
