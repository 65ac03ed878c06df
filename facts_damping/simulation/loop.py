"""The closed loop without ROS: builds its parts and runs it with the compiled ticks of `tick`."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.names import controller_names
from facts_damping.errors import RunError
from facts_damping.link.stages import SPOOF
from facts_damping.link.transfer import RING_NO_ROOM
from facts_damping.measurement.build import clocks_differ
from facts_damping.plant.build import longest_step
from facts_damping.record import Record
from facts_damping.signals import (
    CHANNELS,
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    LEARNING,
    MACHINE_TRUTH,
    SETPOINT,
    SUPERVISION,
)
from facts_damping.simulation.assembly import (
    build_control,
    build_links,
    build_plant,
    build_pmus,
    build_supervisors,
    commands,
    derivatives,
    grid_events,
    learning_rates,
    plant_residues,
    supervised,
)
from facts_damping.simulation.measured_plant import with_pmus
from facts_damping.simulation.parts import lent, new
from facts_damping.simulation.programs.policies import check, connect
from facts_damping.simulation.restarts import Restarts
from facts_damping.simulation.tick import ControlSystem, Loop, Signals, Used, run_half_ticks
from facts_damping.version import versions

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.plant.build import Built
    from facts_damping.small_signal.residues import Residues

BY_TICK = ("time_ns", "frames", "measured_ns", "status", "machines", "devices", "in_synchronism")
TICKS_AT_ONCE = 12  # between such blocks other threads can run, and progress is shown


def setpoint_buffer(per_arrival: int, entries: int) -> NDArray[Any]:
    """Array for the setpoints of a tick: `per_arrival` for each of at most `entries` arrivals, plus a supervisor's."""
    return np.zeros(per_arrival * (entries + 1), SETPOINT)


def build_loop(
    case: Case,
    residues: Residues | None = None,
    built: Built | None = None,
    *,
    outside: bool = False,
    part: Callable[..., Any] = new,
) -> Loop:
    """Build all parts of a case at the start of the run; `residues`: as for `build_control`.

    `built`: its plant, if already built; the loop uses its state. `outside`: setpoints may come from outside, such as
    from a user's own node. `part`: as `parts.lent` gives it.
    """
    built = build_plant(case) if built is None else built
    links, pmus = part("frames", case, lambda case: (build_links(case), build_pmus(case)))
    if residues is None and case.supervision is not None:
        residues = plant_residues(case)
    control = part("control", case, lambda case: control_system(case, links.up.out.shape[1], residues))
    measured = with_pmus(built.plant, built.state, *pmus)
    applied = np.zeros(links.down.out.size, SETPOINT)
    spoofed = bool((links.up.chain.rows["model"] == SPOOF).any())
    differ = spoofed or clocks_differ(case.measurement, [s.name for s in case.system.pmus])
    up, down = (way.packets.now_ns.shape[1] for way in (links.up, links.down))
    signals = signals_for(case, len(case.system.pmus) if differ else 1, up, down)
    programs = connect(case, control.bank_state, outside=outside)
    return Loop(measured, links, control, applied, signals, programs)


def control_system(case: Case, entries: int, residues: Residues | None = None) -> ControlSystem:
    """Build controllers, identifiers and supervisors; `entries`: most entries that a link delivers in a tick."""
    issued = setpoint_buffer(commands(case), entries)
    parts = *build_control(case, residues), *build_supervisors(case, residues)
    return ControlSystem(*parts, issued, issued.copy())


def signals_for(case: Case, stamps: int, up: int, down: int) -> Signals:
    """Arrays for a loop's signals; `stamps`: most time stamps in a frame; `up`, `down`: most copies made by links."""
    rows = case.ticks * 2 * commands(case) * stamps  # a controller acts at each new stamp
    delivered = case.ticks * len(case.system.pmus) * len(case.links) * up
    return allocate_signals(case, case.ticks, delivered=delivered, issued=rows, applied=rows * down)


def allocate_signals(case: Case, ticks: int, *, delivered: int, issued: int, applied: int) -> Signals:
    """Allocate arrays for the signals of `ticks` ticks, with room for the given numbers of rows."""
    watched = supervised(case)
    return Signals(
        np.zeros(ticks, np.int64),
        np.zeros((ticks, len(case.system.pmus), len(CHANNELS))),
        np.zeros((ticks, len(case.system.pmus)), np.int64),
        np.zeros((ticks, len(case.system.pmus)), np.int64),
        np.zeros((ticks, len(case.system.machines)), MACHINE_TRUTH),
        np.zeros((ticks, len(case.run.devices)), DEVICE_TRUTH),
        np.zeros(ticks, np.bool_),
        np.zeros(delivered, DELIVERY),
        np.zeros(issued, SETPOINT),
        np.zeros(applied, SETPOINT),
        np.zeros(ticks * derivatives(case), ESTIMATE),
        np.zeros(ticks * learning_rates(case), LEARNING),
        np.zeros(issued + ticks * commands(case) if watched else 0, SETPOINT),
        np.zeros(ticks * watched + 1, SUPERVISION),
        np.zeros(len(Used._fields), np.int64),
    )


def step(loop: Loop, tick: int) -> bool:
    """Run the next tick of a loop; returns False if the plant is no longer sound and has stopped.

    Raises `RunError` if a user's program has failed.
    """
    sound = bool(run_half_ticks(loop, 2 * tick, 2 * tick + 2))
    check(loop.programs)
    return sound


def run_loop(loop: Loop, progress: Callable[[int, int], object] = lambda *_: None) -> None:
    """Run all ticks, or until the plant is no longer sound; `progress`: called with the ticks done, and all.

    Raises `RunError` if a user's program has failed.
    """
    restarts, last = Restarts(loop.control.bank, loop.control.bank_state), loop.signals.time_ns.size
    begins, goes_on = sorted({*restarts.ticks(last), *range(0, last, TICKS_AT_ONCE), last}), True
    for first, until in pairwise(begins):
        restarts.begin(first)
        goes_on = goes_on and run_half_ticks(loop, 2 * first, 2 * until)
        progress(until, last)
    check(loop.programs)


def with_half_step(case: Case) -> Case:
    """The case with the integrator's longest step halved."""
    step = longest_step(case.system, case.run.devices) / 2
    return replace(case, system=case.system.model_copy(update={"step": step}))


def run(case: Case, change: Callable[[Loop], Loop] | None = None) -> Record:
    """Run a case's closed loop in process, after a `change` of it; returns the record of all signals."""
    with lent() as part:
        loop = build_loop(case, part=part)
        return finish(case, change(loop) if change else loop)


def finish(case: Case, loop: Loop, progress: Callable[[int, int], object] = lambda *_: None) -> Record:
    """Run a loop from start to end; returns its record. The loop keeps its final state."""
    run_loop(loop, progress)
    return record(case, loop)


def record(case: Case, loop: Loop) -> Record:
    """The record of the ticks that a loop has run."""
    arrays = loop.signals
    refused = int(loop.links.up.ring[:, RING_NO_ROOM].sum() + loop.links.down.ring[:, RING_NO_ROOM].sum())
    if refused:
        raise RunError(f"link: {refused} entries did not fit into the buffer; delays are longer than planned")
    used = Used(*arrays.used.tolist())
    entries, setpoints, applied = used.delivered, used.issued, used.applied
    if entries > len(arrays.delivered) or setpoints > len(arrays.issued) or applied > len(arrays.applied):
        raise RunError(f"loop: {entries} entries, {setpoints} setpoints, {applied} applied: more than the buffers hold")
    signals: dict[str, Any] = {name: getattr(arrays, name)[: used.ticks] for name in BY_TICK}
    signals |= {name: getattr(arrays, name)[:count] for name, count in zip(used._fields[1:], used[1:], strict=True)}
    return Record(
        configuration=case.document(),
        pmus=[s.name for s in case.system.pmus],
        machine_names=[m.name for m in case.system.machines],
        device_names=list(case.run.devices),
        controller_names=controller_names(case),
        **signals,
        links=len(case.links),
        events=[event for event in grid_events(case) if event.time_ns <= arrays.time_ns[used.ticks - 1]],
        versions=versions(),
    )
