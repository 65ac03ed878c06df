"""What is judged in a record: the speed differences, and the times of the events."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.errors import InputError
from facts_damping.signals import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.signals import Record

SPEED = list(CHANNELS).index("speed_deviation")


def speed_differences(record: Record) -> dict[str, NDArray[np.float64]]:
    """Local and interarea speed differences as measured: name -> (ticks,), p.u. of synchronous speed.

    `dw = sum_i c_i dw_i` over stations i with the weights c of `configuration["measures"]`:
    {"local" | "interarea": {name: {station: weight}}}. Raises InputError if they do not fit the record.
    """
    groups: Mapping[str, Mapping[str, Any]] = record.configuration.get("measures") or {}
    differences = {
        name: _weighted(record, f"measures.{group}.{name}", weights)
        for group, members in groups.items()
        for name, weights in members.items()
    }
    if not differences:
        raise InputError("measures: the record's configuration names no speed difference")
    return differences


def event_times(record: Record) -> list[float]:
    """Times of the events that happened before the record's end, s, ascending."""
    events = record.configuration.get("events") or record.events
    end = record.time_ns[-1] / 1e9 if len(record.time_ns) else 0.0
    return sorted(time for time in (float(event["time"]) for event in events) if time <= end)


def columns(signals: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    """Signals side by side: (ticks, n)."""
    return np.column_stack(list(signals.values()))


def _weighted(record: Record, field: str, weights: Mapping[str, float]) -> NDArray[np.float64]:
    total = np.zeros(len(record.time_ns))
    for station, weight in weights.items():
        if station not in record.stations:
            raise InputError(f"{field}: no station {station!r}; allowed: {', '.join(record.stations)}")
        total += float(weight) * record.frames[:, record.stations.index(station), SPEED]
    return total
