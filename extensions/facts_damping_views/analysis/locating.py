"""Where an oscillation comes from: places of a grid by the energy that they put into it.

The energy flows at the PMUs (`energy_flow`) give what each part of the grid between them (`cells`) produces. The part
that produces most, as the mean over windows of time, is named as the source; the fraction of the windows in which it
produces most is the confidence. A source that reaches over several areas is divided at their borders, where voltages
and currents are estimated from the data of the network (`network_state`).
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
from facts_damping_views.analysis import energy_flow, network_state
from facts_damping_views.analysis.cells import areas, cells, ends

if TYPE_CHECKING:
    from collections.abc import Sequence
    from collections.abc import Set as AbstractSet

    from facts_damping.parameters.plant.system import System
    from facts_damping.record import Record
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
    """Places, the strongest source first, and the measurements behind them.

    `within`: the parts of the first place by area, likewise, if it reaches over several. `flow` (PMUs,): mean energy
    flow, p.u. rad/s; NaN: not measured. `since`, `until`: time used, s.
    """

    frequency: float
    since: float
    until: float
    windows: int
    places: list[Place]
    within: list[Place]
    pmus: list[str]
    flow: list[float]
    amplitude: list[float]  # (PMUs,), of the active power, p.u.

    @property
    def source(self) -> Place:
        """The place that is named: the first, or the first within it."""
        return (self.within or self.places)[0]


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
    where = Location(
        frequency, start, end, len(flows.windows), ranked(system, flows, out), [], *_at_pmus(system, flows)
    )
    return where._replace(within=_by_area(system, measured, frequency, out, where.places[0].cell))


def _at_pmus(system: System, flows: energy_flow.EnergyFlow) -> tuple[list[str], list[float], list[float]]:
    """Names of the PMUs, mean energy flow, amplitude."""
    return [pmu.name for pmu in system.pmus], flows.flow.mean(axis=0).tolist(), flows.amplitude.tolist()


def _by_area(
    system: System, measured: energy_flow.Phasors, frequency: float, out: AbstractSet[str], cell: Cell
) -> list[Place]:
    """The parts of a cell by area, the strongest source first; empty if it has one area."""
    if len(cell.areas) < 2 or len(cell.buses) < 2:
        return []
    inside = {name: pair for name, pair in ends(system, out).items() if set(pair) <= set(cell.buses)}
    more = network_state.at_borders(areas(system), inside)
    wider = system.model_copy(update={"pmus": [*system.pmus, *more]})
    flows = energy_flow.energy_flow(network_state.extended(system, measured, more, out), frequency)
    return ranked(wider, flows, out, set(cell.buses))


def quiet(record: Record) -> tuple[float, float]:
    """Start and end of the longest time without events of a record, s."""
    end = float(record.time_s[-1])
    borders = sorted({0.0, end, *event_times(record)})
    return max(pairwise(borders), key=lambda span: span[1] - span[0], default=(0.0, end))


def last_event(record: Record) -> float:
    """Time of the last event of a record that is not after its end, s; 0: none."""
    return max((t for t in event_times(record) if t < float(record.time_s[-1])), default=0.0)


def ranked(
    system: System, measured: energy_flow.EnergyFlow, out: AbstractSet[str], inside: AbstractSet[str] = frozenset()
) -> list[Place]:
    """Places by what they produce; PMUs that lack data in a window count as absent.

    `out`: elements out of service; `inside`: buses, of which alone places count. Raises `InputError` if PMUs do not
    divide the grid.
    """
    there = np.asarray(np.isfinite(measured.flow).all(axis=0))
    grid = cells(system, [bool(ok) for ok in there], out)
    count = [c for c, cell in enumerate(grid.cells) if not inside or (cell.buses and set(cell.buses) <= inside)]
    flow = np.where(there, measured.flow, 0.0)
    produced = flow @ grid.balance[count].T  # (windows, cells)
    mean = produced.mean(axis=0)
    largest = float(np.abs(mean).max())
    if len(grid.cells) < 2 or not largest > 0.0:
        raise InputError(
            "no PMU given that divides the grid; allowed: PMUs at machines, or at all branches of a border"
        )
    firsts = np.bincount(produced.argmax(axis=1), minlength=len(mean)) / len(produced)
    error = produced.std(axis=0, ddof=1) / np.sqrt(len(produced))
    return [
        Place(
            grid.cells[count[c]], float(mean[c]), float(mean[c] / largest), float(error[c] / largest), float(firsts[c])
        )
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


def lines(where: Location) -> list[str]:
    """A verdict, and the table of places."""
    first = where.places[0]
    cell, within = first.cell, f" in {some_of(first.cell.areas, 4)}" if first.cell.areas else ""
    if len(cell.units) == 1 and not cell.loads:
        source = f"{cell.units[0]} at {cell.bus}{within}"
    else:
        source = f"between PMUs, at or behind {words(cell)}{within}"
    verdict = f"the source of {where.frequency:.3f} Hz is {source}: first in {_windows(first, where)}"
    if first.first < CLEAR:
        verdict = f"the source of {where.frequency:.3f} Hz is not clear; most comes from {source}"
    if where.within:
        part = where.within[0]
        verdict += f"; by the network's data in {some_of(part.cell.areas, 4)}, first in {_windows(part, where)}"
    largest = max(abs(place.production) for place in where.places)
    used = f"{where.since:.1f} to {where.until:.1f} s; energy relative to the largest, {largest:.3g} p.u. rad/s"
    heads = ("place", "bus", "area", "energy", "error", "first")
    text = [verdict, used, "", *table(heads, _rows(where, where.places), 3)]
    if len(where.places) > SHOWN:
        text.append(f"and {len(where.places) - SHOWN} more that produce less")
    if where.within:
        text += ["", "the first of them by area:", *table(heads, _rows(where, where.within), 3)]
    return text


def _windows(place: Place, where: Location) -> str:
    return f"{round(place.first * where.windows)} of {where.windows} windows"


def _rows(where: Location, places: Sequence[Place]) -> list[tuple[str, ...]]:
    return [
        (words(p.cell), p.cell.bus, some_of(p.cell.areas, 3), f"{p.relative:+.3f}", f"{p.scatter:.3f}",
         f"{round(p.first * where.windows)}/{where.windows}")
        for p in places[:SHOWN]
    ]  # fmt: skip
