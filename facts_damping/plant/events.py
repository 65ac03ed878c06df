"""Conversion of a list of events to stages with a constant network."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError, check_known
from facts_damping.parameters import run as events
from facts_damping.plant.grid.network import FaultPlace, Topology, check_islands
from facts_damping.signals import to_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.parameters.plant.system import System
    from facts_damping.parameters.run import Event


@dataclass(frozen=True)
class TopologyInterval:
    """The grid from `start_ns` on: topology, and mechanical powers relative to the start."""

    start_ns: int = 0
    topology: Topology = field(default_factory=Topology)
    mechanical_scale: Mapping[str, float] = field(default_factory=dict)


class Change(NamedTuple):
    """One change at one instant; `where` names the event in the user's list."""

    time_ns: int
    where: str
    event: Event


def timeline(listed: Sequence[Event]) -> list[Change]:
    """All changes sorted by time, including the clearing of faults with a duration."""
    found = []
    for i, event in enumerate(listed):
        found.append(Change(to_ns(event.time), f"events.{i}", event))
        if isinstance(event, events.Fault) and event.duration is not None:
            end = event.time + event.duration
            clear = events.Clear(time=end, kind="clear", bus=event.bus, line=event.line)
            found.append(Change(to_ns(end), f"events.{i}.duration", clear))
    return sorted(found, key=lambda change: change.time_ns)


def topology_intervals(system: System, listed: Sequence[Event]) -> list[TopologyInterval]:
    """The stages of a run, beginning at the start. Raises `InputError` if an event is impossible."""
    found = [TopologyInterval()]
    check_islands(system, found[0].topology, f"system {system.name}: has an")
    for change in timeline(listed):
        after = _apply(system, found[-1], change)
        check_islands(system, after.topology, f"{change.where} ({change.event.kind}): leaves an")
        if change.time_ns == found[-1].start_ns:
            found[-1] = after
        else:
            found.append(replace(after, start_ns=change.time_ns))
    return found


def _apply(system: System, stage: TopologyInterval, change: Change) -> TopologyInterval:
    event, where, before = change.event, change.where, stage.topology
    lines = [line.name for line in system.lines]
    buses = [bus.name for bus in system.buses]
    if isinstance(event, (events.Fault, events.Clear)):
        if event.bus is not None:
            check_known(f"{where}.bus", event.bus, buses)
        elif event.line is not None:
            check_known(f"{where}.line", event.line, lines)
        return replace(stage, topology=_fault(before, event, where))
    if isinstance(event, events.LineSwitch):
        branches = lines + [t.name for t in system.transformers]
        closed = [name for name in branches if name not in before.lines_out]
        if event.kind == "line_out":
            check_known(f"{where}.line", event.line, closed)
            return replace(stage, topology=replace(before, lines_out=before.lines_out | {event.line}))
        check_known(f"{where}.line", event.line, [name for name in branches if name in before.lines_out])
        return replace(stage, topology=replace(before, lines_out=before.lines_out - {event.line}))
    if isinstance(event, events.LoadStep):
        check_known(f"{where}.load", event.load, [load.name for load in system.loads])
        return replace(
            stage, topology=replace(before, load_scale={**before.load_scale, event.load: 1.0 + event.change})
        )
    running = [m.name for m in system.machines if m.name not in before.machines_out]
    check_known(f"{where}.machine", event.machine, running)
    if isinstance(event, events.MechanicalPowerStep):
        return replace(stage, mechanical_scale={**stage.mechanical_scale, event.machine: 1.0 + event.change})
    return replace(stage, topology=replace(before, machines_out=before.machines_out | {event.machine}))


def _fault(before: Topology, event: events.Fault | events.Clear, where: str) -> Topology:
    element = event.bus or event.line or ""
    burning = [place for place in before.faults if (place.bus, place.line) == (event.bus, event.line)]
    if isinstance(event, events.Clear):
        if not burning:
            places = ", ".join(place.bus or place.line or "" for place in before.faults)
            raise InputError(f"{where}: '{element}' given, which has no fault; allowed: {places or 'none'}")
        return replace(before, faults={place: z for place, z in before.faults.items() if place not in burning})
    if burning:
        raise InputError(f"{where}: '{element}' given, which has a fault already; allowed: one fault an element")
    location = event.location if event.line is not None else 0.0
    place = FaultPlace(event.bus, event.line, location)
    return replace(before, faults={**before.faults, place: complex(event.r, event.x)})
