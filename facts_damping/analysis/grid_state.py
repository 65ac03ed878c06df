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

    from facts_damping.record import GridEvent, Record, RunChange

STATES = LINE, MACHINE, FAULT, FORCED = "line out", "machine out", "fault", "forced"
KINDS = {  # what an event puts an element into, or takes it out of
    "line_out": (LINE, True),
    "line_in": (LINE, False),
    "generator_trip": (MACHINE, True),
    "fault": (FAULT, True),
    "clear": (FAULT, False),
    "forced_oscillation": (FORCED, True),  # with an amplitude of 0: False
}


class GridState(NamedTuple):
    """What differs from the start, from a time on: names of lines and transformers, machines, places of faults.

    `forced`: machines and loads with a forced oscillation. A fault on a line that is out is none.
    """

    time_ns: int = 0
    lines_out: frozenset[str] = frozenset()
    machines_out: frozenset[str] = frozenset()
    faults: frozenset[str] = frozenset()
    forced: frozenset[str] = frozenset()


def grid_states(events: Iterable[GridEvent], resets_ns: Iterable[int]) -> list[GridState]:
    """The states of a grid in order of time, the first that at the start.

    `resets_ns`: times at which the plant was reset, each before the events of that time.
    """
    steps: list[tuple[int, GridEvent | None]] = [(time_ns, None) for time_ns in resets_ns]
    steps += [(event.time_ns, event) for event in events if event.kind in KINDS]
    states, counts = [GridState()], Counter[tuple[str, str]]()
    for time_ns, event in sorted(steps, key=lambda step: step[0]):
        if event is None:
            counts.clear()
        else:
            what, begins = KINDS[event.kind]
            step = 1 if begins and event.value != 0.0 else -1  # NaN: no value belongs to the kind
            counts[what, event.element] = max(0, counts[what, event.element] + step)
        lines, machines, faults, forced = (
            frozenset(name for (of, name), n in counts.items() if of == what and n) for what in STATES
        )
        states.append(GridState(time_ns, lines, machines, faults - lines, forced))
    return states


def plant_reset_ns(change: RunChange, frame_rate: int) -> int | None:
    """When a change reset the plant, ns; None: it did not. A supervisor has a `reset` of its own."""
    return change.tick * NANOSECONDS // frame_rate if (change.role, change.kind) == ("plant", "reset") else None


def states_of(record: Record) -> list[GridState]:
    """The states of a record's grid (`grid_states`)."""
    resets = [plant_reset_ns(change, record.frame_rate) for change in record.changes]
    return grid_states(record.events, [time_ns for time_ns in resets if time_ns is not None])


def islands(system: Mapping[str, Any], lines_out: frozenset[str]) -> list[list[str]]:
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
