"""The twin of a run with noise, from which its response is computed (analysis/response.py).

It has

- the same noise and no events;
- or, where events leave lines out for good, the same noise and a trip of these lines at the start, so that both runs
  are of one plant after the events, and their difference is a free oscillation;
- or, as a mirror, the same events and all noise of the opposite sign, of loads and of PMUs. Mirrors are antithetic
  variates (J. M. Hammersley and K. W. Morton, A new Monte Carlo technique: antithetic variates, Proc. Cambridge Phil.
  Soc. 52 (1956) 449-475). A mirror is needed where loads or units have changed for good, as the same noise then moves
  another plant, where a controller learns, as the event teaches it, and where a supervisor has tripped one;
- or the same noise and a pulse, if the run has no event.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING

from facts_damping.analysis.response import MIRROR, OUTAGE, PULSE_END, PULSED, WITHOUT_EVENTS, Twin, noisy
from facts_damping.analysis.supervision import supervision, trips
from facts_damping.case.loading import recorded_case
from facts_damping.control.table import kind_of
from facts_damping.errors import FactsDampingError, InputError
from facts_damping.parameters.events import Scenario
from facts_damping.plant.events import topology_intervals
from facts_damping.plant.grid.network import Topology
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.loop import build_loop, run

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case
    from facts_damping.plant.events import TopologyInterval
    from facts_damping.record import Record, RunChange
    from facts_damping.simulation.tick import Loop

    Grid = tuple[Topology, dict[str, float], dict[str, float]]

OUTAGE_S = 0.02  # s, when lines trip in the twin that begins without them
PULSE = 0.01  # of a load or, p.u., of a mechanical power
EVENTS = ("event", "reset")  # changes that a run without events does not have


def mirrored(loop: Loop) -> Loop:
    """A loop with all noise of the opposite sign."""
    plant, pmus = loop.measured.plant, loop.measured.pmus
    plant, pmus = plant._replace(load_noise=-plant.load_noise), pmus._replace(normal=-pmus.normal)
    return loop._replace(measured=loop.measured._replace(plant=plant, pmus=pmus))


def without_events(case: Case) -> Case:
    """A case without its events."""
    return replace(case, scenario=case.scenario.model_copy(update={"events": []}))


def with_pulse(case: Case, size: float = PULSE) -> Case:
    """A case whose one event is a pulse of half a second, of a fraction of the first load.

    Without loads, the pulse is in the first machine's mechanical power, p.u. Raises `InputError` if there is neither.
    """
    if case.system.loads:
        kind = {"kind": "load_step", "load": case.system.loads[0].name}
    elif case.system.machines:
        kind = {"kind": "mechanical_power_step", "machine": case.system.machines[0].name}
    else:
        text = "no load and no machine given, in which a pulse could be; allowed: at least one"
        raise InputError(f"system {case.system.name}: {text}")
    rows = [{**kind, "time": PULSE_END - 0.5, "change": size}, {**kind, "time": PULSE_END, "change": 0.0}]
    return replace(case, scenario=Scenario.model_validate({"name": "pulse", "events": rows}))


def changed(record: Record) -> bool:
    """Whether events happened that are not in the run's scenario."""
    return any(change.kind in EVENTS for change in record.changes)


def kind_of_twin(case: Case, record: Record) -> str:
    """The kind of twin that a run needs."""
    if not case.scenario.events and not changed(record):
        return PULSED
    learns = any(c.scheme or c.policy or c.fmu for c in case.controllers)  # or is not known to be linear
    if changed(record) or learns or trips(supervision(record, None)):
        return MIRROR
    first, last = grids(case)
    if first == last:
        return WITHOUT_EVENTS
    only_lines = last == (Topology(lines_out=last[0].lines_out), {}, {})
    return OUTAGE if only_lines else MIRROR


def with_outage(case: Case) -> Case:
    """A case whose only events are that the lines that its events leave out trip at the start."""
    out = grids(case)[-1][0].lines_out
    rows = [{"time": OUTAGE_S, "kind": "line_out", "line": line} for line in sorted(out)]
    return replace(case, scenario=Scenario.model_validate({"name": "outage", "events": rows}))


def grids(case: Case) -> tuple[Grid, Grid]:
    """The grid before the first event and after the last one."""
    intervals = topology_intervals(case.system, case.scenario.events)
    return _grid(intervals[0]), _grid(intervals[-1])


def _grid(interval: TopologyInterval) -> Grid:
    """What an interval's grid is: topology, and the loads and mechanical powers that differ from the start."""
    loads, powers = (
        {name: scale for name, scale in scales.items() if scale != 1.0}
        for scales in (interval.topology.load_scale, interval.mechanical_scale)
    )
    out = interval.topology.lines_out
    faults = {place: z for place, z in interval.topology.faults.items() if place.line not in out}
    return replace(interval.topology, load_scale={}, faults=faults), loads, powers


def twin(case: Case, record: Record, kind: str | None = None) -> Twin | None:
    """The twin of a run; None without noise. `kind`: another than the run needs."""
    if not noisy(record.configuration):
        return None
    kind = kind or kind_of_twin(case, record)
    other = _again(OTHERS[kind](case), record.changes, mirror=kind == MIRROR)
    return Twin(other, kind, cache(partial(_quiet, case, record.changes)) if kind == MIRROR else None)


def _quiet(case: Case, changes: Sequence[RunChange]) -> tuple[Record, Record]:
    """A run and its mirror without events."""
    quiet, others = without_events(case), [change for change in changes if change.kind not in EVENTS]
    return _again(quiet, others), _again(quiet, others, mirror=True)


def _again(case: Case, changes: Sequence[RunChange], *, mirror: bool = False) -> Record:
    """A run with recorded changes."""
    if not changes:
        return run(case, mirrored if mirror else None)
    loop = build_loop(case)
    return rerun(case, changes, mirrored(loop) if mirror else loop)


OTHERS: dict[str, Callable[[Case], Case]] = {
    WITHOUT_EVENTS: without_events,
    OUTAGE: with_outage,
    MIRROR: lambda case: case,
    PULSED: with_pulse,
}


def twin_of(record: Record) -> Twin | None:
    """The twin of a recorded run, simulated in process with its changes.

    None without noise, and if the run cannot be simulated: parts of it are missing or came from outside.
    """
    if record.notes or not noisy(record.configuration):  # before a case is made, which takes longer than a short run
        return None
    try:
        over = {"duration": len(record.time_ns) / record.frame_rate}  # it may have been stopped
        case = recorded_case({**record.configuration, **over}, "recording")
        return None if any(kind_of(controller).node for controller in case.controllers) else twin(case, record)
    except FactsDampingError:
        return None
