"""Conversion of a list of events to intervals with a constant network, and a table of forced oscillations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import InputError, check_known
from facts_damping.parameters import events
from facts_damping.plant.grid.network import FaultPlace, Topology, check_islands
from facts_damping.signals import NEVER, to_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.events import Event
    from facts_damping.parameters.plant.system import System

    Lasting = events.Fault | events.Brake | events.ForcedOscillation


OSCILLATION = np.dtype(
    [
        ("machine", "i8"),  # index, or -1
        ("load", "i8"),  # index among the plant's loads, or -1
        ("exciter", "i8"),  # index of its machine, or -1
        ("inverter", "i8"),  # index, or -1
        ("input", "i8"),  # signal of the inverter that it is added to (`build` writes it)
        ("square", "i8"),  # 1: the sign of the sine
        ("frequency", "f8"),  # Hz
        ("amplitude", "f8"),  # relative to the power
        ("ramp", "f8"),  # s
        ("start_ns", "i8"),
        ("full_ns", "i8"),  # end of the ramp
        ("end_ns", "i8"),
    ]
)
LASTING = (events.Fault, events.Brake, events.ForcedOscillation)  # events that may have a duration


@dataclass(frozen=True)
class TopologyInterval:
    """The grid from `start_ns` on: topology, mechanical powers relative to the start, number of each bus's island."""

    start_ns: int = 0
    topology: Topology = field(default_factory=Topology)
    mechanical_scale: Mapping[str, float] = field(default_factory=dict)
    islands: Mapping[str, int] = field(default_factory=dict)


class Change(NamedTuple):
    """One change at one instant; `where` names the event in the user's list."""

    time_ns: int
    where: str
    event: Event


def timeline(listed: Sequence[Event]) -> list[Change]:
    """All changes sorted by time, including the ends of events with a duration.

    A forced oscillation ends with one of amplitude 0.
    """
    changes = []
    for i, event in enumerate(listed):
        changes.append(Change(to_ns(event.time), f"events.{i}", event))
        if isinstance(event, LASTING) and event.duration is not None:
            end = event.time + event.duration
            changes.append(Change(to_ns(end), f"events.{i}.duration", _end(event, end)))
    return sorted(changes, key=lambda change: change.time_ns)


def _end(event: Lasting, time: float) -> Event:
    if isinstance(event, events.Fault):
        return events.Clear(time=time, kind="clear", bus=event.bus, line=event.line)
    if isinstance(event, events.Brake):
        return events.Brake(time=time, kind="brake_out", bus=event.bus)
    return event.model_copy(update={"time": time, "amplitude": 0.0, "ramp": 0.0, "duration": None})


def topology_intervals(system: System, listed: Sequence[Event]) -> list[TopologyInterval]:
    """The intervals of a run, beginning at the start. Raises `InputError` if an event is impossible."""
    intervals = [TopologyInterval(islands=check_islands(system, Topology(), f"system {system.name}: has an"))]
    for change in timeline(listed):
        after = _apply(system, intervals[-1], change)
        if after is intervals[-1]:
            continue
        islands = check_islands(system, after.topology, f"{change.where} ({change.event.kind}): leaves an")
        after = replace(after, islands=islands)
        if change.time_ns == intervals[-1].start_ns:
            intervals[-1] = after
        else:
            intervals.append(replace(after, start_ns=change.time_ns))
    return intervals


def _apply(system: System, interval: TopologyInterval, change: Change) -> TopologyInterval:
    event, where, before = change.event, change.where, interval.topology
    lines = [line.name for line in system.lines]
    buses = [bus.name for bus in system.buses]
    if isinstance(event, (events.Fault, events.Clear)):
        if event.bus is not None:
            check_known(f"{where}.bus", event.bus, buses)
        elif event.line is not None:
            check_known(f"{where}.line", event.line, lines)
        return replace(interval, topology=_fault(before, event, where))
    if isinstance(event, events.Brake):
        check_known(f"{where}.bus", event.bus, buses)
        return replace(interval, topology=_brake(before, event, where, system.base_power))
    if isinstance(event, events.LineSwitch):
        branches = lines + [t.name for t in system.transformers]
        closed = [name for name in branches if name not in before.lines_out]
        if event.kind == "line_out":
            check_known(f"{where}.line", event.line, closed)
            return replace(interval, topology=replace(before, lines_out=before.lines_out | {event.line}))
        check_known(f"{where}.line", event.line, [name for name in branches if name in before.lines_out])
        return replace(interval, topology=replace(before, lines_out=before.lines_out - {event.line}))
    if isinstance(event, events.LoadStep):
        check_known(f"{where}.load", event.load, [load.name for load in system.loads])
        return replace(
            interval, topology=replace(before, load_scale={**before.load_scale, event.load: 1.0 + event.change})
        )
    if isinstance(event, events.ForcedOscillation):
        _check_oscillation(system, before, event, where)
        return interval
    units = system.machines if isinstance(event, events.MechanicalPowerStep) else system.units
    check_known(f"{where}.machine", event.machine, [u.name for u in units if u.name not in before.machines_out])
    if isinstance(event, events.MechanicalPowerStep):
        return replace(interval, mechanical_scale={**interval.mechanical_scale, event.machine: 1.0 + event.change})
    return replace(interval, topology=replace(before, machines_out=before.machines_out | {event.machine}))


def _check_oscillation(system: System, before: Topology, event: events.ForcedOscillation, where: str) -> None:
    gone = before.machines_out if event.amplitude > 0.0 else ()  # it may end after a trip
    places = {
        "load": [load.name for load in system.loads],
        "machine": [m.name for m in system.machines if m.name not in gone],
        "exciter": [e.machine for e in system.exciters if getattr(e, "enabled", True) and e.machine not in gone],
        "inverter": [i.name for i in system.inverters if i.name not in gone],
    }
    for place, names in places.items():
        if (name := getattr(event, place)) is not None:
            check_known(f"{where}.{place}", name, names)
    if event.load is not None and event.amplitude > 1.0:
        raise InputError(f"{where}.amplitude: {event.amplitude:g} given; allowed: at most 1, the whole load")
    if event.frequency * system.step > 0.5 + 1e-9:  # the step may be rounded up
        allowed = f"at most {0.5 / system.step:g}, in Hz, half the rate of integration steps"
        raise InputError(f"{where}.frequency: {event.frequency:g} given; allowed: {allowed}")


def _brake(before: Topology, event: events.Brake, where: str, base_power: float) -> Topology:
    if event.power is None:  # `brake_out`
        if event.bus not in before.brakes:
            problem = f"'{event.bus}' given, where no brake is inserted"
            raise InputError(f"{where}: {problem}; allowed: {', '.join(before.brakes) or 'none'}")
        return replace(before, brakes={bus: g for bus, g in before.brakes.items() if bus != event.bus})
    if event.bus in before.brakes:
        raise InputError(f"{where}: '{event.bus}' given, where a brake is inserted already; allowed: one brake a bus")
    return replace(before, brakes={**before.brakes, event.bus: event.power / base_power})


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


def _oscillating(listed: Sequence[Event]) -> list[events.ForcedOscillation]:
    return [event for event in listed if isinstance(event, events.ForcedOscillation) and event.amplitude > 0.0]


def oscillating_loads(listed: Sequence[Event]) -> set[str]:
    """Names of the loads with a forced oscillation."""
    return {event.load for event in _oscillating(listed) if event.load is not None}


def oscillations(
    listed: Sequence[Event], machines: Sequence[str], loads: Sequence[str], inverters: Sequence[str]
) -> NDArray[Any]:
    """The forced oscillations among the events, rows of OSCILLATION; none for an amplitude of 0."""
    rows = []
    for event in _oscillating(listed):
        among = ((event.machine, machines), (event.load, loads), (event.exciter, machines), (event.inverter, inverters))
        at = [-1 if name is None else names.index(name) for name, names in among]
        what = *at, 0, int(event.waveform == "square"), event.frequency, event.amplitude, event.ramp
        end = NEVER if event.duration is None else to_ns(event.time + event.duration)
        rows.append((*what, to_ns(event.time), to_ns(event.time + event.ramp), end))
    return np.array(rows, OSCILLATION)
