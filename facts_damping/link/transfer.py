"""Entries under way: queues ordered by time of arrival, and what each link delivers in a tick; compiled.

A link has two directions: PMU entries from stations to controllers (DELIVERY) and setpoints from
controllers to devices (SETPOINT). The links of a run stand side by side, in arrays that hold the
largest. The link nodes and the in-process loop call the same `uplink` and `downlink`, the plant's node
and the loop the same `merge`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled, inlined
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
    """One direction of a link: its chain, and the state: a ring of entries under way, ordered by arrival.

    Several of them have a leading axis.
    """

    chain: NDArray[Any]  # STAGE
    entries: NDArray[Any]  # DELIVERY or SETPOINT, (capacity,)
    arrival_ns: NDArray[np.int64]  # (capacity,)
    sent_ns: NDArray[np.int64]  # (capacity,)
    ring: NDArray[np.int64]  # head, count, and how many were delivered in the tick
    statistics: NDArray[Any]  # STATISTICS, (channels,)
    out: NDArray[Any]  # entries delivered in the tick, (capacity,)


class Links(NamedTuple):
    """The links of a run, side by side; the first axis of both directions is the link."""

    up: Direction
    down: Direction
    used: NDArray[np.int64]  # (controllers,), index of the link that each uses


def directions(
    chains: Sequence[Sequence[Stage]], dtype: np.dtype[Any], channels: int, per_tick: int, frame_rate: int
) -> Direction:
    """One empty direction of several links, each with room for all that can be under way.

    That is `per_tick` entries a tick for the longest delay of all. A second's worth more is for setpoints that come
    late and all at once, in real time.
    """
    n, stages = len(chains), max(len(own) for own in chains)
    tables = np.array([chain(own, stages) for own in chains])
    ticks = max(longest_delay_ns(table) for table in tables) * frame_rate // NANOSECONDS + 3 + frame_rate
    capacity = max(per_tick, 1) * ticks
    statistics = np.zeros((n, max(channels, 1)), STATISTICS)
    statistics["delay_min_ns"] = np.iinfo(np.int64).max
    return Direction(
        tables,
        np.zeros((n, capacity), dtype),
        np.zeros((n, capacity), np.int64),
        np.zeros((n, capacity), np.int64),
        np.zeros((n, 3), np.int64),
        statistics,
        np.zeros((n, capacity), dtype),
    )


def links(
    given: Sequence[Link], used: Sequence[int], stations: int, devices: int, commands: int, frame_rate: int
) -> Links:
    """The links of a run: at least one; `used` says which one each controller uses.

    `commands` is the number of setpoints that all controllers give at one arrival.
    """
    up = directions([link.up for link in given], DELIVERY, stations, stations, frame_rate)
    down = directions([link.down for link in given], SETPOINT, devices, 2 * commands, frame_rate)
    return Links(up, down, np.array(used, np.int64))


@inlined
def one(several: Direction, link: int) -> Direction:
    """A direction of one of several links, as views; for compiled callers alone, who keep the arrays.

    Written into its callers, as they are into the loop: called, with all these arrays to hand over, they take half as
    long again.
    """
    return Direction(
        several.chain[link],
        several.entries[link],
        several.arrival_ns[link],
        several.sent_ns[link],
        several.ring[link],
        several.statistics[link],
        several.out[link],
    )


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


@inlined
def uplink(made: Links, link: int, tick: int, start_ns: int, end_ns: int, frame: NDArray[np.float64]) -> int:
    """Send a frame (stations, channels) measured at `start_ns` up a link; deliver what arrives before `end_ns`.

    The delivered entries stand in `made.up.out[link]`, in order of arrival; returns their number.
    """
    way = one(made.up, link)
    for station in range(frame.shape[0]):
        slot = _push(way, station, start_ns)
        if slot < 0:
            continue
        entry = way.entries[slot]
        entry.station = station
        entry.link = link
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
    way.ring[2] = count
    return count


@inlined
def downlink(made: Links, link: int, tick: int, end_ns: int, setpoints: NDArray[Any], given: int) -> int:
    """Send those of `given` setpoints whose controllers use a link down it, each at its `issued_ns`.

    Deliver what arrives before `end_ns` into `made.down.out[link]`, as `uplink` does.
    """
    way = one(made.down, link)
    for i in range(given):
        if made.used[setpoints[i].controller] != link:
            continue
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
    way.ring[2] = count
    return count


@inlined
def merge(table: NDArray[Any], filled: int, setpoints: NDArray[Any], count: int) -> int:
    """Put `count` setpoints, as a link delivers them, among the `filled` ones of a table, by the time they take effect.

    Those of one time stay in the order in which they are put in: link by link. Returns how many there are then.
    """
    for i in range(count):
        place = filled
        while place > 0 and table[place - 1].effective_ns > setpoints[i].effective_ns:
            table[place] = table[place - 1]
            place -= 1
        table[place] = setpoints[i]
        filled += 1
    return filled
