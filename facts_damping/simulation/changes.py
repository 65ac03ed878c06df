"""Changes during a run, applied by nodes and, bit for bit the same, in process.

A change acts at the start of a tick, before the measurement. The nodes publish each change with its tick (RunChange),
so a recording holds all changes and can be run again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.links import beside, link_of, with_number
from facts_damping.case.loading import make_case
from facts_damping.case.measurement import with_number as with_measured
from facts_damping.case.named_files import read_source
from facts_damping.control.bank import put
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError
from facts_damping.input_files import naming_no_files
from facts_damping.link.transfer import Links, changed, replaced
from facts_damping.monitor_table import COMMANDS
from facts_damping.parameters.field_errors import worded
from facts_damping.parameters.files import read_value
from facts_damping.plant.load_noise import fitted as fitted_noise
from facts_damping.plant.model import fitted
from facts_damping.plant.watchdog import initial_watch, let_go, rearm
from facts_damping.signals import NANOSECONDS, SETPOINT
from facts_damping.simulation.assembly import build_plant, build_pmus, commands, grid_events, ways
from facts_damping.simulation.loop import build_loop, record, setpoint_buffer, signals_for, step
from facts_damping.simulation.measured_plant import tick_ns, with_pmus
from facts_damping.simulation.restarts import Restarts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.measurement.pmu_model import Pmus
    from facts_damping.parameters.link import Link
    from facts_damping.plant.build import Built
    from facts_damping.plant.model import Plant, PlantState
    from facts_damping.record import GridEvent, Record, RunChange
    from facts_damping.simulation.tick import Loop
    from facts_damping.supervision.model import Supervisors, SupervisorState

SOURCE = "change"  # name of the source in error messages


def with_event(case: Case, text: str, at_ns: int) -> Case:
    """The case with one more event at a time; `text`: YAML, as in a scenario, without `time`.

    Raises `InputError` if it is not an event, or not possible at that time.
    """
    event = read_value(text, SOURCE)
    if not isinstance(event, dict) or "time" in event:
        raise InputError(f"{SOURCE}: {text!r} given; allowed: an event without time, {{kind: line_out, line: NAME}}")
    content = case.document()
    content["scenario"] = [*content["scenario"], {"time": at_ns / NANOSECONDS, **event}]
    listed = make_case(content, SOURCE).scenario.events
    return replace(case, scenario=case.scenario.model_copy(update={"events": listed}))


def with_link(case: Case, index: int, source: Any) -> Case:
    """The case with link `index` replaced; `source`: name, YAML text or parsed YAML.

    Raises `InputError` if it is not a link, or does not fit the run.
    """
    with naming_no_files("a change of a run"), worded(SOURCE):
        value = read_value(source, SOURCE) if isinstance(source, str) else source
        link = link_of(read_source("links", value, "link"))
    owner = next((c for c, used in enumerate(case.used_links) if used == index and case.run.controllers[c].link), None)
    content = case.document()
    (content if owner is None else content["controllers"][owner])["link"] = link.model_dump()
    make_case(content, SOURCE)
    return with_links(case, index, beside(link, case.measurement))


def with_links(case: Case, index: int, link: Link) -> Case:
    """The case with link `index` replaced by `link`."""
    return replace(case, links=[link if i == index else other_link for i, other_link in enumerate(case.links)])


def relinked(links: Links, case: Case, index: int) -> Links:
    """Running links with the stages of link `index` taken from the case."""
    up, down = (
        replaced(getattr(links, way), index, [getattr(link, way) for link in case.links], spec)
        for way, spec in ways(case).items()
    )
    return links._replace(up=up, down=down)


def renumbered(links: Links, case: Case, index: int, path: str, value: float) -> tuple[Links, Case]:
    """Running links with a number of a stage changed, such as `up.0.delay`, and the changed case."""
    way, place, link = with_number(case.links[index], path, value)
    new = changed(getattr(links, way), index, place, getattr(link, way)[place], ways(case)[way])
    return links._replace(up=new) if way == "up" else links._replace(down=new), with_links(case, index, link)


def measured_otherwise(case: Case, path: str, value: float, before: Pmus) -> tuple[Pmus, Case]:
    """PMUs with a number of the measurement changed, such as `noise.angle`, and the changed case."""
    now = replace(case, measurement=with_measured(case.measurement, path, value))
    return build_pmus(now, before=before)[0], now


def pending(case: Case, events: Sequence[GridEvent], at_ns: int) -> list[GridEvent]:
    """Grid events not yet published at a time: those of `events` before it, and all of the case from then on."""
    late = [event for event in events if event.time_ns < at_ns]
    return late + [event for event in grid_events(case) if event.time_ns >= at_ns]


def reset_plant(case: Case, at_ns: int) -> tuple[Built, Case]:
    """The plant at equilibrium at a time, and the case with its scenario shifted to it; `case`: as at the start."""
    events = [event.model_copy(update={"time": event.time + at_ns / NANOSECONDS}) for event in case.scenario.events]
    again = replace(case, scenario=case.scenario.model_copy(update={"events": events}))
    return build_plant(again), again


def apply(loop: Loop, now: Case, start: Case, change: RunChange) -> tuple[Loop, Case]:
    """Apply a change, as in `Record.changes`: returns the changed loop and case.

    `now`: the case so far; `start`: the case as at the start of the run.
    """
    measured, what, value, index = loop.measured, change.kind, change.value, change.index
    at = tick_ns(change.tick, measured.pmus.frame_rate)
    change_watch(now.run.devices, measured.plant_state.watch, change, at)
    if change.role == "supervisor":  # first: its `reset` is not that of the plant
        ask(loop.control.supervisors, loop.control.supervisor_state, change)
    elif what == "event":
        now = with_event(now, value, at)
        loop = _with_plant(loop, build_plant(now).plant, measured.plant_state)
    elif what == "reset":
        built, again = reset_plant(start, at)
        loop = _with_plant(loop, built.plant, built.state)
        now = replace(now, scenario=again.scenario)
    elif what == "link":
        now = with_link(now, index, value)
        links = relinked(loop.links, now, index)
        issued = setpoint_buffer(commands(now), links.up.out.shape[1])
        control = loop.control._replace(issued=issued, passed=issued.copy())
        loop = loop._replace(links=links, control=control, applied=np.zeros(links.down.out.size, SETPOINT))
    elif what == "parameter" and change.role == "plant":
        pmus, now = measured_otherwise(now, change.name, float(value), measured.pmus)
        loop = loop._replace(measured=measured._replace(pmus=pmus))
    elif what == "parameter" and change.role == "link":
        links, now = renumbered(loop.links, now, index, change.name, float(value))
        loop = loop._replace(links=links)
    elif what == "parameter":
        set_parameter(now, loop.control.bank, loop.control.identifiers, change)
    return loop, now


def _with_plant(loop: Loop, plant: Plant, state: PlantState) -> Loop:
    """The loop with another plant, in the same noise."""
    plant = plant._replace(load_noise=fitted_noise(loop.measured.plant.load_noise, len(plant.loads)))
    state = fitted(state, plant)
    return loop._replace(measured=with_pmus(plant, state, loop.measured.pmus, loop.measured.pmu_state))


def change_watch(devices: Sequence[str], watch: NDArray[Any], change: RunChange, at_ns: int) -> None:
    """Apply a change of the plant to the watchdogs of its devices; other changes have no effect."""
    if change.role != "plant":
        return
    if change.kind == "rearm":
        rearm(watch, at_ns)
    elif change.kind == "reset":
        watch[:] = initial_watch(len(watch))
    elif change.kind == "release" and change.name in devices:
        let_go(watch, devices.index(change.name))


def by_tick(changes: Sequence[RunChange]) -> dict[int, list[RunChange]]:
    """Changes by the tick at which they act, in order."""
    grouped: dict[int, list[RunChange]] = {}
    for change in changes:
        grouped.setdefault(change.tick, []).append(change)
    return grouped


def set_parameter(case: Case, bank: Any, identifiers: Any, change: RunChange) -> None:
    """Set a parameter in the settings of a controller or its identifier."""
    c, name = change.index, change.name
    rows: NDArray[Any] = bank.settings[c]
    if change.role == "identifier":
        rows = identifiers.settings[list(identifiers.controller).index(c)]
    put(rows, name, kind_of(case.controllers[c]).parameters[name], change.value, bank.mode_shape[c])


def ask(supervisors: Supervisors, state: SupervisorState, change: RunChange) -> None:
    """Pass an operator's command to a supervisor, which executes it at the start of its next tick."""
    supervised = list(supervisors.settings["controller"])
    if change.kind in COMMANDS and change.index in supervised:
        state.rows["asked"][supervised.index(change.index)] = COMMANDS[change.kind]


def rerun(case: Case, changes: Sequence[RunChange], loop: Loop | None = None) -> Record:
    """Run a closed loop in process with recorded changes; gives the record of the lockstep graph.

    `loop`: the case's, not yet run; None: it is built.
    """
    loop, now, events = loop or build_loop(case), case, grid_events(case)
    if any(change.kind in ("link", "parameter") for change in changes):  # copies of entries, stamps of their own
        loop = loop._replace(signals=signals_for(case, stamps=len(case.system.pmus), up=2, down=2))
    passed: list[GridEvent] = []
    at_ticks, restarts = by_tick(changes), Restarts(loop.control.bank, loop.control.bank_state)
    for tick in range(case.ticks):
        at = tick_ns(tick, loop.measured.pmus.frame_rate)
        restarts.begin(tick)
        for change in at_ticks.get(tick, ()):
            loop, now = apply(loop, now, case, change)
            events = pending(now, events, at)
        while events and events[0].time_ns <= at:
            passed.append(events.pop(0))
        if not step(loop, tick):
            break
    return replace(record(case, loop), events=passed, changes=list(changes))
