"""Latency from measurement to actuation, and frames lost on the links."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from facts_damping.signals import NANOSECONDS, NEVER

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from facts_damping.record import Record

Value = TypeVar("Value")
MILLISECOND = 1_000_000  # ns
HOPS = {
    "up": "measured to arrived",
    "wait": "arrived to issued",
    "down": "issued to device",
    "whole": "measured to device",
}


class Statistics(NamedTuple):
    """Mean, median, 99 % quantile and maximum; None of nothing."""

    mean: float | None
    p50: float | None
    p99: float | None
    max: float | None


def ages_ms(record: Record, rows: NDArray[Any] | None = None) -> NDArray[np.float64]:
    """Latency of each applied setpoint, or of `rows` of them, ms of simulated time, (setpoints,); see `latency`.

    NaN for an impossible value, negative or longer than the run so far: a wrong clock or a forged stamp. Setpoints that
    use no measurement are left out (`measured`).
    """
    rows = measured(record) if rows is None else rows
    begins = rows["tick"] * NANOSECONDS // record.frame_rate
    return _between(rows["measured_ns"], np.maximum(rows["effective_ns"], begins))


def measured(record: Record) -> NDArray[Any]:
    """Applied setpoints that use a measurement; without supervisors' zeros and probing tones.

    Those are issued at the end of their tick and have that time as their time of measurement.
    """
    rows, rate = record.applied, record.frame_rate
    ends = (rows["issued_ns"] * rate // NANOSECONDS + 1) * NANOSECONDS // rate - 1
    watched = np.isin(rows["controller"], record.supervision["controller"])
    silent = watched & (rows["measured_ns"] == rows["issued_ns"]) & (rows["issued_ns"] == ends)
    return np.asarray(rows[~silent])


def _between(measured_ns: NDArray[np.int64], later_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Time from a measurement to a later event, ms; NaN if impossible."""
    sound = (measured_ns >= 0) & (later_ns >= measured_ns)
    return np.where(sound, (later_ns - measured_ns) / MILLISECOND, np.nan)


def latency(record: Record) -> Statistics:
    """Statistics of the applied setpoints' latency, ms of simulated time.

    Latency = time at which the setpoint acts on the device - time of measurement of the newest frame it uses. It covers
    both links and the wait for alignment. A setpoint acts when it reaches the device, but not before the tick in which
    it was delivered: in real time a node may be late.
    """
    ages = ages_ms(record)
    return statistics(ages[np.isfinite(ages)])


def left_out(record: Record) -> int:
    """Number of applied setpoints with an impossible latency."""
    return int(np.count_nonzero(np.isnan(ages_ms(record))))


def statistics(values: NDArray[np.float64]) -> Statistics:
    """Statistics of values (n,)."""
    if not len(values):
        return Statistics(None, None, None, None)
    p50, p99 = np.percentile(values, [50, 99])
    return Statistics(float(values.mean()), float(p50), float(p99), float(values.max()))


def alike(values: Mapping[str, Value]) -> dict[Value, list[str]]:
    """Group names by equal values."""
    groups: dict[Value, list[str]] = {}
    for name, value in values.items():
        groups.setdefault(value, []).append(name)
    return groups


def cdf(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Empirical distribution: values (n,) ascending, and the fraction of all values up to each, 1/n to 1."""
    return np.sort(values), np.arange(1, len(values) + 1) / max(len(values), 1)


def hops_ms(record: Record) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Latency of each hop from the time stamps, ms of simulated time: {hop: {name: (n,)}}.

    - `up`: from measurement to arrival at the controllers, per entry, by PMU (`pmu/link` with several links);
    - `wait`: from the first arrival of the newest frame that a setpoint uses to its issue, by controller: the wait for
      its other signals;
    - `down`: from issue to the device, by device;
    - `whole`: from measurement to the device, by device: `latency` of each.

    The hops of a setpoint need not add up to the whole if frames overtake each other or are duplicated. Undelivered
    entries have no latency: see `frames_lost`.
    """
    up = _between(record.delivered["measured_ns"], record.delivered["arrival_ns"])
    down = _between(record.applied["issued_ns"], record.applied["effective_ns"])
    devices, whole = dict(enumerate(record.device_names)), measured(record)
    links = np.unique(record.delivered["link"]).tolist()
    suffixes = {link: f"/{link}" if len(links) > 1 else "" for link in links}
    ways = {(i, link): name + suffix for i, name in enumerate(record.pmus) for link, suffix in suffixes.items()}
    return {
        "up": _by(up, ways, record.delivered[["pmu", "link"]]),
        "wait": _by(_waits(record), dict(enumerate(record.controller_names)), record.issued["controller"]),
        "down": _by(down, devices, record.applied["device"]),
        "whole": _by(ages_ms(record, whole), devices, whole["device"]),
    }


def _by(values: NDArray[np.float64], names: Mapping[Any, str], keys: NDArray[Any]) -> dict[str, NDArray[np.float64]]:
    """Finite values by the name of their key; names without values are left out."""
    parts = {name: values[(keys == np.array(key, keys.dtype)) & np.isfinite(values)] for key, name in names.items()}
    return {name: part for name, part in parts.items() if len(part)}


def _waits(record: Record) -> NDArray[np.float64]:
    """Time from the first arrival of a setpoint's newest frame, over its link, to its issue, ms, (setpoints,)."""
    waits = np.full(len(record.issued), np.nan)
    for controller, link in enumerate(_links(record)):
        entries = record.delivered[record.delivered["link"] == link]
        entries = entries[np.lexsort((entries["arrival_ns"], entries["measured_ns"]))]
        measured, first = np.unique(entries["measured_ns"], return_index=True)
        rows = np.flatnonzero(record.issued["controller"] == controller)
        if not len(measured):
            continue
        issued = record.issued[rows]
        place = np.minimum(np.searchsorted(measured, issued["measured_ns"]), len(measured) - 1)
        known = measured[place] == issued["measured_ns"]
        arrived = entries["arrival_ns"][first[place]]
        waits[rows] = np.where(known, (issued["issued_ns"] - arrived) / MILLISECOND, np.nan)
    return waits


def _links(record: Record) -> list[int]:
    """Index of each controller's link: 0 is the run's, if any controller uses it; own links follow in order."""
    with_link = [bool(row.get("link")) for row in record.configuration.get("controllers") or ()]
    with_link += [False] * (len(record.controller_names) - len(with_link))
    places, following = [], 0 if all(with_link) else 1
    for has in with_link:
        places.append(following if has else 0)
        following += has
    return places


def frames_lost(record: Record) -> int:
    """Number of PMU entries that were measured but never arrived, over all links, silent PMUs included.

    Entries may still be under way at the end if they were measured later than the longest latency of their path before
    it; these are not counted. A path without any arrival takes the longest latency of all paths.
    """
    rows = record.delivered
    late = np.where(rows["measured_ns"] < 0, 0, rows["arrival_ns"] - rows["measured_ns"])
    lost, end = 0, int(record.time_ns.max(initial=0))
    for link in range(record.links):
        for pmu in range(len(record.pmus)):
            path = (rows["link"] == link) & (rows["pmu"] == pmu)
            longest = int(late[path if path.any() else slice(None)].max(initial=0))
            stamps = record.measured_ns[:, pmu]
            measured = stamps[(stamps != NEVER) & (stamps <= end - longest)]
            arrived = set(rows["measured_ns"][path].tolist())
            lost += sum(stamp not in arrived for stamp in measured.tolist())
    return lost
