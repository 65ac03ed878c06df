"""Entries under way: a queue ordered by time of arrival, and what a link delivers in a tick; compiled.

One link has two directions, each a `Direction`: PMU entries from stations to controllers (DELIVERY)
and setpoints from controllers to devices (SETPOINT). The link node and the in-process loop call the
same `uplink` and `downlink`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.link.chain import chain, longest_delay_ns, traverse
from facts_damping.signals import DELIVERY, NANOSECONDS, SETPOINT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Link, Stage

# What became of the entries of one channel (station or device).
STATISTICS = np.dtype(
    [
        ("sent", "i8"),
        ("delivered", "i8"),
        ("lost", "i8"),
        ("delay_sum_ns", "i8"),
        ("delay_min_ns", "i8"),
        ("delay_max_ns", "i8"),
    ]
)


class Direction(NamedTuple):
    """One direction of a link: its chain, and the state: a ring of entries under way, ordered by arrival."""

    chain: NDArray[Any]  # STAGE
    entries: NDArray[Any]  # DELIVERY or SETPOINT, (capacity,)
    arrival_ns: NDArray[np.int64]  # (capacity,)
    sent_ns: NDArray[np.int64]  # (capacity,)
    ring: NDArray[np.int64]  # head, count
    statistics: NDArray[Any]  # STATISTICS, (channels,)
    out: NDArray[Any]  # entries delivered in the tick, (capacity,)


def direction(
    stages: Sequence[Stage], dtype: np.dtype[Any], channels: int, per_tick: int, frame_rate: int
) -> Direction:
    """An empty direction with room for all that can be under way: `per_tick` entries a tick for the longest delay.

    A second's worth more is for setpoints that come late and all at once, in real time.
    """
    table = chain(stages)
    ticks = longest_delay_ns(table) * frame_rate // NANOSECONDS + 3 + frame_rate
    capacity = max(per_tick, 1) * ticks
    statistics = np.zeros(max(channels, 1), STATISTICS)
    statistics["delay_min_ns"] = np.iinfo(np.int64).max
    return Direction(
        table,
        np.zeros(capacity, dtype),
        np.zeros(capacity, np.int64),
        np.zeros(capacity, np.int64),
        np.zeros(2, np.int64),
        statistics,
        np.zeros(capacity, dtype),
    )


def directions(link: Link, stations: int, devices: int, commands: int, frame_rate: int) -> tuple[Direction, Direction]:
    """Both directions of a link; `commands` is the number of setpoints that all controllers give at one arrival."""
    up = direction(link.up, DELIVERY, stations, stations, frame_rate)
    down = direction(link.down, SETPOINT, devices, 2 * commands, frame_rate)
    return up, down


@compiled
def _push(way: Direction, channel: int, sent_ns: int) -> int:
    """Place for an entry in the ring, ordered by arrival, first come first; -1: the ring is full, it is lost."""
    capacity = way.arrival_ns.size
    head, count = way.ring[0], way.ring[1]
    way.statistics[channel].sent += 1
    if count == capacity:
        way.statistics[channel].lost += 1
        return -1
    arrival = traverse(way.chain, sent_ns)
    place = count
    while place > 0:
        before = (head + place - 1) % capacity
        if way.arrival_ns[before] <= arrival:
            break
        here = (head + place) % capacity
        way.entries[here] = way.entries[before]
        way.arrival_ns[here] = way.arrival_ns[before]
        way.sent_ns[here] = way.sent_ns[before]
        place -= 1
    here = (head + place) % capacity
    way.arrival_ns[here] = arrival
    way.sent_ns[here] = sent_ns
    way.ring[1] = count + 1
    return here  # type: ignore[no-any-return]


@compiled
def _first_before(way: Direction, end_ns: int) -> int:
    """Slot of the first entry that arrives before `end_ns`, taken off the ring; -1 when there is none."""
    head = way.ring[0]
    if way.ring[1] == 0 or way.arrival_ns[head] >= end_ns:
        return -1
    way.ring[0] = (head + 1) % way.arrival_ns.size
    way.ring[1] -= 1
    return head  # type: ignore[no-any-return]


@compiled
def _count_delivered(way: Direction, channel: int, slot: int) -> None:
    """Add a delivered entry to the statistics of its channel."""
    delay = way.arrival_ns[slot] - way.sent_ns[slot]
    s = way.statistics[channel]
    s.delivered += 1
    s.delay_sum_ns += delay
    s.delay_min_ns = min(s.delay_min_ns, delay)
    s.delay_max_ns = max(s.delay_max_ns, delay)


@compiled
def uplink(way: Direction, tick: int, start_ns: int, end_ns: int, frame: NDArray[np.float64]) -> int:
    """Send a frame (stations, channels) measured at `start_ns`; deliver what arrives before `end_ns`.

    The delivered entries stand in `way.out`, in order of arrival; returns their number.
    """
    for station in range(frame.shape[0]):
        slot = _push(way, station, start_ns)
        if slot < 0:
            continue
        entry = way.entries[slot]
        entry.station = station
        entry.measured_ns = start_ns
        for i in range(frame.shape[1]):
            entry.values[i] = frame[station, i]
    count = 0
    slot = _first_before(way, end_ns)
    while slot >= 0:
        way.out[count] = way.entries[slot]
        way.out[count].tick = tick
        way.out[count].arrival_ns = way.arrival_ns[slot]
        _count_delivered(way, way.entries[slot].station, slot)
        count += 1
        slot = _first_before(way, end_ns)
    return count


@compiled
def downlink(way: Direction, tick: int, end_ns: int, setpoints: NDArray[Any], given: int) -> int:
    """Send `given` setpoints, each at its `issued_ns`; deliver what arrives before `end_ns`, as `uplink` does."""
    for i in range(given):
        slot = _push(way, setpoints[i].device, setpoints[i].issued_ns)
        if slot >= 0:
            way.entries[slot] = setpoints[i]
    count = 0
    slot = _first_before(way, end_ns)
    while slot >= 0:
        way.out[count] = way.entries[slot]
        way.out[count].tick = tick
        way.out[count].effective_ns = way.arrival_ns[slot]
        _count_delivered(way, way.entries[slot].device, slot)
        count += 1
        slot = _first_before(way, end_ns)
    return count
