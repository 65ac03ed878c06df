"""Transfer of entries: queues ordered by time of arrival, and delivery in a tick; compiled.

A link has two directions: PMU entries from PMUs to controllers (DELIVERY) and setpoints from controllers to devices
(SETPOINT). All links of a run share arrays sized for the largest. The link nodes and the in-process loop call the same
`uplink` and `downlink`; the plant node and the loop call the same `merge`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Array, Float2, Int1, Struct
from facts_damping.link.chain import (
    AllPackets,
    Chain,
    Chains,
    DirectionSpec,
    Packets,
    chains,
    longest_delay_ns,
    put,
    traverse,
)
from facts_damping.signals import DELIVERY, NANOSECONDS, NEVER, SETPOINT, Setpoints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping.parameters.link import Link

# Counts of a channel (PMU or device): sent + duplicated + held = delivered + lost + under way.
STATISTICS = np.dtype(
    [
        ("sent", "i8"),
        ("delivered", "i8"),
        ("lost", "i8"),
        ("duplicated", "i8"),
        ("held", "i8"),
        ("delay_sum_ns", "i8"),
        ("delay_min_ns", "i8"),
        ("delay_max_ns", "i8"),
    ]
)


# Columns of a ring: index of the first entry; numbers of entries under way, delivered in the tick, and dropped because
# the ring was full.
RING_HEAD, RING_COUNT, RING_DELIVERED, RING_NO_ROOM = range(4)


class FrameDirection(Struct):
    """One direction of a link: its chain, and a ring of entries under way, ordered by arrival."""

    chain: Chain
    packets: Packets
    entries: Annotated[NDArray[Any], Array(DELIVERY, 1)]  # (capacity,)
    arrival_ns: Int1  # (capacity,)
    sent_ns: Int1  # (capacity,)
    ring: Int1  # RING_...
    statistics: Annotated[NDArray[Any], Array(STATISTICS, 1)]  # (channels,)
    out: Annotated[NDArray[Any], Array(DELIVERY, 1)]  # entries delivered in the tick, (capacity,)


class SetpointDirection(FrameDirection):
    """The direction of setpoints, from controllers to devices."""

    entries: Annotated[NDArray[Any], Array(SETPOINT, 1)]
    out: Annotated[NDArray[Any], Array(SETPOINT, 1)]


class FrameDirections(FrameDirection, each=FrameDirection):
    """Frame directions of several links."""

    chain: Chains
    packets: AllPackets


class SetpointDirections(FrameDirections, each=SetpointDirection):
    """Setpoint directions of several links."""

    entries: Annotated[NDArray[Any], Array(SETPOINT, 2)]
    out: Annotated[NDArray[Any], Array(SETPOINT, 2)]


Directions = TypeVar("Directions", bound=FrameDirections)


class Links(Struct):
    """The links of a run; the first axis of both directions is the link."""

    up: FrameDirections
    down: SetpointDirections
    used: Int1  # (controllers,): index of each controller's link


def directions(
    kind: type[Directions], by_link: Sequence[Sequence[Any]], dtype: np.dtype[Any], way: DirectionSpec
) -> Directions:
    """Build one empty direction of several links from their stages, with room for all entries under way."""
    chain, packets = chains(by_link, way)
    n, capacity = len(by_link), room_for(chain, way)
    statistics = np.zeros((n, max(len(way.channels), 1)), STATISTICS)
    statistics["delay_min_ns"] = np.iinfo(np.int64).max
    return kind(
        chain,
        packets,
        np.zeros((n, capacity), dtype),
        np.zeros((n, capacity), np.int64),
        np.zeros((n, capacity), np.int64),
        np.zeros((n, 4), np.int64),
        statistics,
        np.zeros((n, capacity), dtype),
    )


def room_for(chain: Chains, way: DirectionSpec) -> int:
    """Number of entries that can be under way: those sent during the longest delay, with copies.

    Entries of one more second are added for setpoints that arrive late and together in real time.
    """
    ticks = longest_delay_ns(chain) * way.frame_rate // NANOSECONDS + 3 + way.frame_rate
    return int(max(way.per_tick, 1) * chain.drawn.shape[3] * ticks)


def links(link_models: Sequence[Link], used: Sequence[int], up: DirectionSpec, down: DirectionSpec) -> Links:
    """Build the links of a run, at least one; `used`: index of each controller's link."""
    return Links(
        directions(FrameDirections, [link.up for link in link_models], DELIVERY, up),
        directions(SetpointDirections, [link.down for link in link_models], SETPOINT, down),
        np.array(used, np.int64),
    )


def changed(direction: Directions, link: int, place: int, stage: Any, way: DirectionSpec) -> Directions:
    """A direction with a stage of a link changed for entries sent from now on; enlarged if needed."""
    put(direction.chain, link, place, stage, way)
    capacity = room_for(direction.chain, way)
    return _roomier(direction, capacity) if capacity > direction.arrival_ns.shape[1] else direction


def replaced(direction: Directions, link: int, by_link: Sequence[Sequence[Any]], way: DirectionSpec) -> Directions:
    """A direction with new stages of a link for entries sent from now on; `by_link`: stages of all links.

    Entries under way remain. The state of this link's stages is reset, that of other links is not.
    """
    chain, packets = chains(by_link, way)
    others = np.arange(len(by_link)) != link
    for before, after in zip(tuple(direction.chain)[2:], tuple(chain)[2:], strict=True):  # draws and stored entries
        where = (others, *(slice(min(sizes)) for sizes in zip(before.shape[1:], after.shape[1:], strict=True)))
        after[where] = before[where]
    packets.number[:] = direction.packets.number
    direction, capacity = direction._replace(chain=chain, packets=packets), room_for(chain, way)
    return _roomier(direction, capacity) if capacity > direction.arrival_ns.shape[1] else direction


def _roomier(direction: Directions, capacity: int) -> Directions:
    """A direction with larger rings; entries are moved to the start of each ring."""
    n, old = direction.arrival_ns.shape

    def wide(ring: NDArray[Any]) -> NDArray[Any]:
        widened = np.zeros((n, capacity), ring.dtype)
        for link in range(n):
            widened[link, :old] = np.roll(ring[link], -direction.ring[link, RING_HEAD])
        return widened

    entries, arrival_ns, sent_ns = wide(direction.entries), wide(direction.arrival_ns), wide(direction.sent_ns)
    direction.ring[:, RING_HEAD] = 0
    out = np.zeros((n, capacity), direction.out.dtype)
    out[:, :old] = direction.out
    return direction._replace(entries=entries, arrival_ns=arrival_ns, sent_ns=sent_ns, out=out)


@compiled
def _put_in(p: Packets, channel: int, sent_ns: int, measured_ns: int) -> None:
    """Place an entry at the start of a chain; the caller fills in its values."""
    p.now_ns[:, channel] = NEVER
    p.now_ns[0, channel], p.stamp_ns[channel] = sent_ns, measured_ns
    p.copied[channel] = p.held[channel] = False


@compiled
def _push(way: Any, sent_ns: int, arrival_ns: int) -> int:
    """Insert a place for an entry into the ring, by arrival, then by insertion; -1: it is lost, or the ring is full."""
    if arrival_ns == NEVER:
        return -1
    capacity, head, count = way.arrival_ns.size, way.ring[RING_HEAD], way.ring[RING_COUNT]
    if count == capacity:
        way.ring[RING_NO_ROOM] += 1
        return -1
    place = count
    here = (head + place) % capacity
    while place > 0:
        before = (head + place - 1) % capacity
        if way.arrival_ns[before] <= arrival_ns:
            break
        way.entries[here] = way.entries[before]
        way.arrival_ns[here], way.sent_ns[here] = way.arrival_ns[before], way.sent_ns[before]
        place, here = place - 1, before
    way.arrival_ns[here], way.sent_ns[here] = arrival_ns, sent_ns
    way.ring[RING_COUNT] = count + 1
    return here  # type: ignore[no-any-return]


@compiled
def _count_sent(p: Packets, statistics: NDArray[Any], channel: int, arriving: int) -> None:
    """Count an entry that has passed its chain; `arriving`: number of its copies that arrive."""
    s = statistics[channel]
    s.sent += 1
    s.duplicated += p.copied[channel]
    s.held += p.held[channel]
    s.lost += 1 + p.copied[channel] + p.held[channel] - arriving
    p.number[channel] += 1


@compiled
def _first_before(way: Any, end_ns: int) -> int:
    """Remove the first entry that arrives before `end_ns` from the ring; returns its slot, or -1 if there is none."""
    head = way.ring[RING_HEAD]
    if way.ring[RING_COUNT] == 0 or way.arrival_ns[head] >= end_ns:
        return -1
    way.ring[RING_HEAD] = (head + 1) % way.arrival_ns.size
    way.ring[RING_COUNT] -= 1
    return head  # type: ignore[no-any-return]


@compiled
def _count_delivered(way: Any, channel: int, slot: int) -> None:
    delay = way.arrival_ns[slot] - way.sent_ns[slot]
    s = way.statistics[channel]
    s.delivered += 1
    s.delay_sum_ns += delay
    s.delay_min_ns = min(s.delay_min_ns, delay)
    s.delay_max_ns = max(s.delay_max_ns, delay)


@entry_point
def uplink(
    all_links: Links, link: int, tick: int, start_ns: int, end_ns: int, frame: Float2, measured_ns: Int1, status: Int1
) -> int:
    """Send a frame (PMUs, channels) up a link at `start_ns`; deliver entries that arrive before `end_ns`.

    `measured_ns`: time of each PMU's measurement, (PMUs,); NEVER: absent from the frame. `status`: bits of each
    PMU's entry. Delivered entries are in `links.up.out[link]`, in order of arrival; returns their number.
    """
    way = all_links.up.each[link]
    p = way.packets
    for pmu in range(frame.shape[0]):
        _put_in(p, pmu, start_ns, measured_ns[pmu])
        p.status[pmu] = status[pmu]
        if measured_ns[pmu] == NEVER:
            p.now_ns[0, pmu] = NEVER
        for i in range(frame.shape[1]):
            p.values[pmu, i] = frame[pmu, i]
    traverse(way.chain, p, start_ns, 0, frame.shape[0])
    for pmu in range(frame.shape[0]):
        arriving = 0
        for copy in range(p.now_ns.shape[0]):
            slot = _push(way, start_ns, p.now_ns[copy, pmu])
            if slot >= 0:
                arriving += 1
                entry = way.entries[slot]
                entry.pmu = pmu
                entry.link = link
                entry.measured_ns = p.stamp_ns[pmu]
                entry.status = p.status[pmu]
                for i in range(frame.shape[1]):
                    entry.values[i] = p.values[pmu, i]
        if measured_ns[pmu] != NEVER or arriving > 0:
            _count_sent(p, way.statistics, pmu, arriving)
    count, slot = 0, _first_before(way, end_ns)
    while slot >= 0:
        way.out[count] = way.entries[slot]
        way.out[count].tick = tick
        way.out[count].arrival_ns = way.arrival_ns[slot]
        _count_delivered(way, way.entries[slot].pmu, slot)
        count, slot = count + 1, _first_before(way, end_ns)
    way.ring[RING_DELIVERED] = count
    return count


@entry_point
def downlink(all_links: Links, link: int, tick: int, end_ns: int, setpoints: Setpoints, ready: int) -> int:
    """Send those of `ready` setpoints whose controllers use a link down that link, each at its `issued_ns`.

    Deliver setpoints that arrive before `end_ns` to `links.down.out[link]`, as `uplink` does.
    """
    way = all_links.down.each[link]
    p = way.packets
    for i in range(ready):
        if all_links.used[setpoints[i].controller] != link:
            continue
        device, issued = setpoints[i].device, setpoints[i].issued_ns
        _put_in(p, device, issued, setpoints[i].measured_ns)
        p.values[device, 0] = setpoints[i].value
        traverse(way.chain, p, issued, device, device + 1)
        arriving = 0
        for copy in range(p.now_ns.shape[0]):
            slot = _push(way, issued, p.now_ns[copy, device])
            if slot >= 0:
                arriving += 1
                way.entries[slot] = setpoints[i]
                way.entries[slot].measured_ns = p.stamp_ns[device]
                way.entries[slot].value = p.values[device, 0]
        _count_sent(p, way.statistics, device, arriving)
    count, slot = 0, _first_before(way, end_ns)
    while slot >= 0:
        way.out[count] = way.entries[slot]
        way.out[count].tick = tick
        way.out[count].effective_ns = way.arrival_ns[slot]
        _count_delivered(way, way.entries[slot].device, slot)
        count, slot = count + 1, _first_before(way, end_ns)
    way.ring[RING_DELIVERED] = count
    return count


@entry_point
def merge(table: Setpoints, filled: int, setpoints: Setpoints, count: int) -> int:
    """Merge `count` setpoints delivered by a link into the `filled` ones of a table, ordered by effective time.

    Setpoints of equal time keep the order of insertion, link by link. Returns the new number.
    """
    for i in range(count):
        place = filled
        while place > 0 and table[place - 1].effective_ns > setpoints[i].effective_ns:
            table[place] = table[place - 1]
            place -= 1
        table[place] = setpoints[i]
        filled += 1
    return filled
