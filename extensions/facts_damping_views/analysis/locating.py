"""Where an oscillation comes from: places of a grid by the energy that they put into it.

The energy flows at the PMUs (`energy_flow`) give what each part of the grid between them (`cells`) produces. The part
that produces most, as the mean over windows of time, comes first; the fraction of the windows in which it produces
most is the confidence. This needs no data but the diagram; but a unit that undamps the oscillation, or a load,
may give more energy than the source. With the grid's data, `causes` tells which source explains the measurements.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.grid_state import states_of
from facts_damping.analysis.measures import event_times
from facts_damping.errors import InputError
from facts_damping.output.tables import some_of, table
from facts_damping.signals import NANOSECONDS
from facts_damping_views.analysis import causes, energy_flow
from facts_damping_views.analysis.cells import cells

if TYPE_CHECKING:
    from collections.abc import Set as AbstractSet

    from facts_damping.parameters.plant.system import System
    from facts_damping.record import Record
    from facts_damping_views.analysis.causes import Cause
    from facts_damping_views.analysis.cells import Cell

CLEAR = 0.5  # least fraction of the windows in which a source is first
SHOWN = 8  # rows of the table


class Place(NamedTuple):
    """A part of the grid: what it produces, p.u. rad/s, and the fraction of the windows in which it is first."""

    cell: Cell
    production: float
    relative: float  # to the largest size of any
    scatter: float  # standard error of `relative`, from the windows
    first: float


class Location(NamedTuple):
    """Sources that explain the measurements, the best first; places by energy, the strongest first; measurements.

    `flow` (PMUs,): mean energy flow, p.u. rad/s; NaN: not measured. `since`, `until`: time used, s.
    """

    frequency: float
    since: float
    until: float
    windows: int
    places: list[Place]
    causes: list[Cause]  # empty if the grid, as it was, has no linear model
    pmus: list[str]
    flow: list[float]
    amplitude: list[float]  # (PMUs,), of the active power, p.u.


def locate(
    record: Record,
    system: System,
    frequency: float | None = None,
    since: float | None = None,
    until: float | None = None,
) -> Location:
    """Where the oscillation in a record comes from.

    `frequency`: Hz; None: the strongest in the active powers. `since`, `until`: s; None: those of the longest time
    without events. Raises `InputError` for a record without currents, one that is too short, without an oscillation.
    """
    start, end = quiet(record)
    start, end = start if since is None else since, end if until is None else until
    measured = energy_flow.phasors(record.frames, record.measured_ns, record.status)
    if not np.isfinite(measured.current).any():
        raise InputError("no currents given; allowed: a recording of PMUs that measure voltages and currents")
    measured = energy_flow.between(measured, start, end)
    if not len(measured.time_s):
        raise InputError(f"no frames from {start:g} to {end:g} s given; allowed: a time within the recording")
    if frequency is None:
        frequency = energy_flow.strongest(measured, record.frame_rate)
    elif not 0.0 < frequency < 0.4 * record.frame_rate:
        allowed = f"above 0, below {0.4 * record.frame_rate:g} Hz, 0.4 of the frame rate"
        raise InputError(f"--frequency: {frequency:g} given; allowed: {allowed}")
    flows = energy_flow.energy_flow(measured, frequency)
    if not np.nanmax(flows.amplitude, initial=0.0) > energy_flow.SMALL:
        raise InputError(f"no oscillation at {frequency:g} Hz given; allowed: one that moves power at a PMU")
    state = [s for s in states_of(record) if s.time_ns <= start * NANOSECONDS + 1][-1]
    out = state.lines_out | state.machines_out
    places = ranked(system, flows, out)
    try:
        whole = energy_flow.energy_flow(measured, frequency, whole=True)
        explained = causes.causes(system, whole, flows, record.device_names, out)
    except InputError:
        explained = []
    return Location(frequency, start, end, len(flows.windows), places, explained, *_at_pmus(system, flows))


def _at_pmus(system: System, flows: energy_flow.EnergyFlow) -> tuple[list[str], list[float], list[float]]:
    """Names of the PMUs, mean energy flow, amplitude."""
    return [pmu.name for pmu in system.pmus], flows.flow.mean(axis=0).tolist(), flows.amplitude.tolist()


def quiet(record: Record) -> tuple[float, float]:
    """Start and end of the longest time without events of a record, s."""
    end = float(record.time_s[-1])
    borders = sorted({0.0, end, *event_times(record)})
    return max(pairwise(borders), key=lambda span: span[1] - span[0], default=(0.0, end))


def last_event(record: Record) -> float:
    """Time of the last event of a record that is not after its end, s; 0: none."""
    return max((t for t in event_times(record) if t < float(record.time_s[-1])), default=0.0)


def ranked(system: System, measured: energy_flow.EnergyFlow, out: AbstractSet[str]) -> list[Place]:
    """Places by what they produce; PMUs that lack data in a window count as absent.

    `out`: elements out of service. Raises `InputError` if PMUs do not divide the grid.
    """
    there = np.asarray(np.isfinite(measured.flow).all(axis=0))
    grid = cells(system, [bool(ok) for ok in there], out)
    flow = np.where(there, measured.flow, 0.0)
    produced = flow @ grid.balance.T  # (windows, cells)
    mean = produced.mean(axis=0)
    largest = float(np.abs(mean).max())
    if len(grid.cells) < 2 or not largest > 0.0:
        raise InputError(
            "no PMU given that divides the grid; allowed: PMUs at machines, or at all branches of a border"
        )
    firsts = np.bincount(produced.argmax(axis=1), minlength=len(mean)) / len(produced)
    error = produced.std(axis=0, ddof=1) / np.sqrt(len(produced))
    return [
        Place(grid.cells[c], float(mean[c]), float(mean[c] / largest), float(error[c] / largest), float(firsts[c]))
        for c in np.argsort(-mean, kind="stable")
    ]


def words(cell: Cell) -> str:
    """What a cell is, in words."""
    if cell.units:
        more = f" and {len(cell.loads)} loads" if len(cell.loads) > 1 else "".join(f" and {x}" for x in cell.loads)
        return some_of(cell.units, 4) + more
    if cell.loads:
        return some_of(cell.loads, 4)
    return f"the grid about {cell.bus}" if len(cell.buses) > 1 else cell.bus


def named(cause: Cause) -> str:
    """The units and loads of a cause with their buses and areas, in words."""
    within = f" in {some_of(cause.areas, 4)}" if cause.areas else ""
    return f"{' or '.join([*cause.units, *cause.loads])} at {' or '.join(cause.buses)}{within}"


def lines(where: Location) -> list[str]:
    """A verdict, the table of sources that explain the measurements, and that of places by energy."""
    at, first = f"{where.frequency:.3f} Hz", where.places[0]
    within = f" in {some_of(first.cell.areas, 4)}" if first.cell.areas else ""
    energy = f"{words(first.cell)} at {first.cell.bus}{within}: first in {_windows(first, where)}"
    text = [f"most energy of {at} comes from {energy}"]
    if where.causes:
        best = where.causes[0]
        clear = "is" if best.first >= CLEAR and best.explained >= CLEAR else "is not clear; most is explained by"
        verdict = f"the source of {at} {clear} {named(best)}: first in {_windows(best, where)}"
        text = [f"{verdict}, explains {best.explained:.2f}", *text]
    largest = max(abs(place.production) for place in where.places)
    text.append(f"{where.since:.1f} to {where.until:.1f} s; energy relative to the largest, {largest:.3g} p.u. rad/s")
    if where.causes:
        heads = ("source", "bus", "area", "explains", "first")
        text += ["", *table(heads, [_cause_row(where, cause) for cause in where.causes[:SHOWN]], 3)]
    by_energy = [_place_row(where, place) for place in where.places[:SHOWN]]
    text += ["", *table(("place by energy", "bus", "area", "energy", "error", "first"), by_energy, 3)]
    if len(where.places) > SHOWN:
        text.append(f"and {len(where.places) - SHOWN} more that produce less")
    return text


def _windows(of: Place | Cause, where: Location) -> str:
    return f"{round(of.first * where.windows)} of {where.windows} windows"


def _cause_row(where: Location, c: Cause) -> tuple[str, ...]:
    share = f"{round(c.first * where.windows)}/{where.windows}"
    return some_of([*c.units, *c.loads], 4), some_of(c.buses, 3), some_of(c.areas, 3), f"{c.explained:.3f}", share


def _place_row(where: Location, p: Place) -> tuple[str, ...]:
    share, areas_of = f"{round(p.first * where.windows)}/{where.windows}", some_of(p.cell.areas, 3)
    return words(p.cell), p.cell.bus, areas_of, f"{p.relative:+.3f}", f"{p.scatter:.3f}", share
