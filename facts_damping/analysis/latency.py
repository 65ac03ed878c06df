"""How old a measurement is when it acts, and what the link lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.signals import Record

MILLISECOND = 1_000_000  # ns


def ages_ms(record: Record) -> NDArray[np.float64]:
    """Latency of each applied setpoint, ms of simulated time, (setpoints,); see `latency`."""
    return np.asarray((record.applied["effective_ns"] - record.applied["measured_ns"]) / MILLISECOND)


def latency(record: Record) -> dict[str, float | None]:
    """Mean, median, 99 % quantile and maximum of the applied setpoints' latency, ms of simulated time.

    Latency = time at which the setpoint reaches the device - time of measurement of the newest frame it
    rests on: the whole way, both links and the wait for alignment. None where nothing was applied.
    """
    ages = ages_ms(record)
    if not len(ages):
        return dict.fromkeys(("mean", "p50", "p99", "max"))
    p50, p99 = np.percentile(ages, [50, 99])
    return {"mean": float(ages.mean()), "p50": float(p50), "p99": float(p99), "max": float(ages.max())}


def frames_lost(record: Record) -> int:
    """Entries of stations that were measured, yet neither delivered nor possibly still under way, over all links.

    An entry counts as under way if no later one of its station was delivered by the same link. So of a station that
    never got through nothing counts, and an entry that a later one overtook just before the end counts as lost.
    """
    ways = np.unique(record.delivered[["link", "station"]])
    return sum(_lost(record, link, station) for link, station in ways)


def _lost(record: Record, link: int, station: int) -> int:
    own = (record.delivered["link"] == link) & (record.delivered["station"] == station)
    delivered = record.delivered["measured_ns"][own]
    measured = record.time_ns[record.time_ns <= delivered.max()]
    return int(np.setdiff1d(measured, delivered).size)
