"""What of a grid is out of service, faulted or forced to oscillate, by the plant's own events and resets alone."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.devices.base import Series, Transmission
from facts_damping.devices.table import MODELS
from facts_damping.numerics.matrices import parts
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from collections.abc import Set as AbstractSet

    from facts_damping.record import GridEvent, Record, RunChange

LINE, MACHINE, FAULT, FORCED = range(4)  # what an element may be in: fields of a GridState
KINDS = {  # what an event puts an element into or, with -1, takes it out of
    "line_out": (LINE, 1),
    "line_in": (LINE, -1),
    "generator_trip": (MACHINE, 1),
    "fault": (FAULT, 1),
    "clear": (FAULT, -1),
    "forced_oscillation": (FORCED, 1),  # it ends by one of amplitude 0
}


class GridState(NamedTuple):
    """What differs from the start, by name, from a time on; a fault on a line that is out is none."""

    time_ns: int = 0
    lines_out: AbstractSet[str] = frozenset()  # and transformers
    machines_out: AbstractSet[str] = frozenset()
    faults: AbstractSet[str] = frozenset()  # buses and lines
    forced: AbstractSet[str] = frozenset()  # machines and loads with a forced oscillation


def grid_states(events: Iterable[GridEvent], resets_ns: Iterable[int]) -> list[GridState]:
    """The states of a grid in order of time, the first that at the start.

    `resets_ns`: times at which the plant was reset, each before the events of that time.
    """
    steps: list[tuple[int, GridEvent | None]] = [(time_ns, None) for time_ns in resets_ns]
    steps += [(event.time_ns, event) for event in events if event.kind in KINDS]
    states, counts = [GridState()], Counter[tuple[int, str]]()
    for time_ns, event in sorted(steps, key=lambda step: step[0]):
        if event is None:
            counts.clear()
        else:
            field, step = KINDS[event.kind]
            place = field, event.element
            counts[place] = max(0, counts[place] + (step if event.value != 0.0 else -1))  # NaN: it has no value
        lines, machines, faults, forced = ({e for (k, e), n in counts.items() if n and k == i} for i in range(4))
        states.append(GridState(time_ns, lines, machines, faults - lines, forced))
    return states


def plant_reset_ns(change: RunChange, frame_rate: int) -> int | None:
    """When a change reset the plant, ns; None: it did not. A supervisor has a `reset` of its own."""
    return change.tick * NANOSECONDS // frame_rate if (change.role, change.kind) == ("plant", "reset") else None


def states_of(record: Record) -> list[GridState]:
    """The states of a record's grid (`grid_states`)."""
    resets = [plant_reset_ns(change, record.frame_rate) for change in record.changes]
    return grid_states(record.events, [time_ns for time_ns in resets if time_ns is not None])


def islands(system: Mapping[str, Any], lines_out: AbstractSet[str]) -> list[list[str]]:
    """Connected groups of buses, the largest first; `system`: as configured, as data.

    Series devices always connect; an HVDC link does not.
    """
    names = [bus["name"] for bus in system.get("buses") or () if isinstance(bus, dict)]
    devices = system.get("devices") or ()
    series = [row for row in devices if not issubclass(MODELS.get(row.get("kind"), Series), Transmission)]
    branches = [*(system.get("lines") or ()), *(system.get("transformers") or ()), *series]
    index, ends = {name: i for i, name in enumerate(names)}, []
    for branch in branches:
        first, second = branch.get("from_bus", branch.get("from")), branch.get("to_bus", branch.get("to"))
        if branch["name"] not in lines_out and None not in (first, second):
            ends.append((index[first], index[second]))
    groups: dict[int, list[str]] = {}
    for name, number in zip(names, parts(len(names), ends), strict=True):
        groups.setdefault(number, []).append(name)
    return sorted(groups.values(), key=len, reverse=True)
