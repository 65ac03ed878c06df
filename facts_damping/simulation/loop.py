"""The closed loop without ROS: `step`, one compiled tick of everything, and whole runs of it.

The order of a tick (docs/architecture.md): measure, uplink, act, learn, downlink, advance. The nodes call
the same functions, each its own; here they are called in one compiled loop.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.names import controller_names
from facts_damping.compiling import compiled, inner, part, released
from facts_damping.control.bank import Bank, BankState, act, set_estimate
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.control.table import DIRECT, INDIRECT
from facts_damping.errors import RunError
from facts_damping.link.stages import SPOOF
from facts_damping.link.transfer import Links, downlink, merge, uplink
from facts_damping.measurement.build import clocks_differ
from facts_damping.neurofuzzy.learning import view, write_learning
from facts_damping.neurofuzzy.network import shape_of
from facts_damping.plant.model import Plant, PlantState, Work, workspace
from facts_damping.signals import (
    CHANNELS,
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    LEARNING,
    MACHINE_TRUTH,
    SETPOINT,
    Record,
)
from facts_damping.simulation.build import (
    build_control,
    build_links,
    build_plant,
    build_pmus,
    commands,
    derivatives,
    grid_events,
    learning_rates,
)
from facts_damping.simulation.measured_plant import go_on, observe, tick_ns
from facts_damping.simulation.policies import check, connect

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.identifier_model import Identifiers, IdentifierState
    from facts_damping.measurement.pmu import Pmus, PmuState
    from facts_damping.plant.build import Built
    from facts_damping.simulation.policies import Program
    from facts_damping.small_signal.residues import Residues


class Signals(NamedTuple):
    """Arrays that a run fills: see `signals.Record`; `used` holds ticks and the rows of the tables, in this order."""

    time_ns: NDArray[np.int64]
    frames: NDArray[np.float64]
    measured_ns: NDArray[np.int64]
    status: NDArray[np.int64]
    machines: NDArray[Any]
    devices: NDArray[Any]
    in_synchronism: NDArray[np.bool_]
    delivered: NDArray[Any]
    issued: NDArray[Any]
    applied: NDArray[Any]
    estimates: NDArray[Any]
    learning: NDArray[Any]
    used: NDArray[np.int64]


class Loop(NamedTuple):
    """Everything a closed loop consists of: frozen parameters and state, each part by itself, and what it records."""

    plant: Plant
    plant_state: PlantState
    work: Work
    pmus: Pmus
    pmu_state: PmuState
    links: Links
    bank: Bank
    bank_state: BankState
    identifiers: Identifiers
    identifier_state: IdentifierState
    issued: NDArray[Any]  # SETPOINT, what the controllers issue in a tick
    applied: NDArray[Any]  # SETPOINT, what all links deliver to the devices in a tick
    signals: Signals
    programs: list[Program]  # of controllers of the user's own, which the compiled step calls


def setpoint_buffer(commands: int, entries: int) -> NDArray[Any]:
    """Room for the setpoints of a tick: `commands` at each arrival, and each delivered entry may be one."""
    return np.zeros(commands * entries, SETPOINT)


def build_loop(
    case: Case, residues: Residues | None = None, built: Built | None = None, *, outside: bool = False
) -> Loop:
    """All parts of a case, at the start; `residues`: its plant's, as for `build_control`.

    `built`: its plant, where it is at hand; the loop takes its state over. `outside`: setpoints may come from there, as
    those of a node of the user's own in a graph.
    """
    built = build_plant(case) if built is None else built
    links = build_links(case)
    control = build_control(case, residues)
    work = workspace(built.plant, built.state)
    issued = setpoint_buffer(commands(case), links.up.out.shape[1])
    applied = np.zeros(links.down.out.size, SETPOINT)
    spoofed = bool((links.up.chain.rows["model"] == SPOOF).any())
    stamps = (
        len(case.system.stations)
        if spoofed or clocks_differ(case.measurement, [s.name for s in case.system.stations])
        else 1
    )
    up, down = (way.packets.now_ns.shape[1] for way in (links.up, links.down))
    signals = signals_for(case, stamps, up, down)
    pmus, pmu_state = build_pmus(case)
    programs = connect(case, control[1], outside=outside)
    return Loop(built.plant, built.state, work, pmus, pmu_state, links, *control, issued, applied, signals, programs)


def signals_for(case: Case, stamps: int, up: int, down: int) -> Signals:
    """Arrays for the signals of a case's loop; `stamps`: most in a frame, `up`, `down`: most copies that links make."""
    rows = case.ticks * 2 * commands(case) * stamps  # a controller acts at each stamp that is new
    delivered = case.ticks * len(case.system.stations) * len(case.links) * up
    return allocate_signals(case, case.ticks, delivered=delivered, issued=rows, applied=rows * down)


def allocate_signals(case: Case, ticks: int, *, delivered: int, issued: int, applied: int) -> Signals:
    """Arrays for the signals of so many ticks, with room for so many entries and setpoints."""
    return Signals(
        np.zeros(ticks, np.int64),
        np.zeros((ticks, len(case.system.stations), len(CHANNELS))),
        np.zeros((ticks, len(case.system.stations)), np.int64),
        np.zeros((ticks, len(case.system.stations)), np.int64),
        np.zeros((ticks, len(case.system.machines)), MACHINE_TRUTH),
        np.zeros((ticks, len(case.run.devices)), DEVICE_TRUTH),
        np.zeros(ticks, np.bool_),
        np.zeros(delivered, DELIVERY),
        np.zeros(issued, SETPOINT),
        np.zeros(applied, SETPOINT),
        np.zeros(ticks * derivatives(case), ESTIMATE),
        np.zeros(ticks * learning_rates(case), LEARNING),
        np.zeros(6, np.int64),
    )


@inner
def _append(kept: NDArray[Any], at: int, entries: NDArray[Any], count: int) -> int:
    """Keep `count` entries from index `at` on, as far as there is room; the index after the last."""
    for i in range(min(count, kept.size - at)):
        kept[at + i] = entries[i]
    return at + count


@compiled
def control_step(
    bank: Bank,
    bank_state: BankState,
    ids: Identifiers,
    id_state: IdentifierState,
    used: NDArray[np.int64],
    delivered: NDArray[Any],
    ring: NDArray[np.int64],
    given: NDArray[Any],
    heard: NDArray[Any],
    count: int,
    tick: int,
    kept: Signals,
) -> int:
    """Controllers act on what was delivered in a tick, then identifiers learn from that and from setpoints.

    `delivered`, (links, entries), and `ring`, which says how many there are, as in `link.transfer.Direction`;
    controller c uses link `used[c]`. What controllers issue goes into `given`. Identifiers hear `count` setpoints of
    `heard`; where that is -1, those that were issued. What they estimate is used in the tick after. Returns how many
    setpoints were issued.
    """
    issued = 0
    for c in range(bank.code.size):
        issued = act(bank, bank_state, c, tick, delivered[used[c]], ring[used[c], 2], given, issued)
    kept.used[2] = _append(kept.issued, kept.used[2], given, issued)
    if count < 0:
        heard, count = given, issued
    rows = kept.used[4]
    for n in range(ids.controller.size):
        c = ids.controller[n]
        identify(ids, id_state, n, delivered[used[c]], ring[used[c], 2])
        store_setpoints(ids, id_state, n, heard, count)
        rows = write_estimates(ids, id_state, n, tick, kept.estimates, rows)
        set_estimate(bank_state, c, id_state.jacobian[n], id_state.change[n], id_state.held.newest_ns[n])
    kept.used[4], rows = rows, kept.used[5]
    for c in range(bank.code.size):
        if bank.code[c] == DIRECT or bank.code[c] == INDIRECT:
            net = shape_of(bank.shape[c])
            own, fall = view(bank_state.learner, c, net), bank_state.memory.lyapunov[c]
            rows = write_learning(net, own, fall, tick, c, 0, kept.learning, rows)
    for n in range(ids.controller.size):
        net = shape_of(ids.shape[n])
        own, fall = view(id_state.learner, n, net), id_state.lyapunov[n]
        rows = write_learning(net, own, fall, tick, ids.controller[n], 1, kept.learning, rows)
    kept.used[5] = rows
    return issued


@part
def _begin(
    plant: Plant,
    plant_state: PlantState,
    work: Work,
    pmus: Pmus,
    pmu_state: PmuState,
    links: Links,
    kept: Signals,
    tick: int,
) -> bool:
    """The first half of a tick: PMUs measure, links deliver upwards; whether the plant is sound."""
    start, end = tick_ns(tick, pmus.frame_rate), tick_ns(tick + 1, pmus.frame_rate)
    frame, measured_ns, status = kept.frames[tick], kept.measured_ns[tick], kept.status[tick]
    truth = kept.machines[tick], kept.devices[tick]
    sound = observe(plant, plant_state, pmus, pmu_state, tick, frame, measured_ns, status, *truth, work)
    kept.time_ns[tick] = start
    kept.in_synchronism[tick] = sound
    kept.used[0] = tick + 1
    for link in range(links.up.ring.shape[0]):
        delivered = uplink(links, link, tick, start, end, frame, measured_ns, status)
        kept.used[1] = _append(kept.delivered, kept.used[1], links.up.out[link], delivered)
    return sound


@part
def _end(
    plant: Plant,
    plant_state: PlantState,
    work: Work,
    pmus: Pmus,
    pmu_state: PmuState,
    links: Links,
    bank: Bank,
    bank_state: BankState,
    ids: Identifiers,
    id_state: IdentifierState,
    given: NDArray[Any],
    taken: NDArray[Any],
    kept: Signals,
    tick: int,
    sound: bool,
) -> bool:
    """The second half of a tick: controllers act, identifiers learn, links deliver downwards, the plant goes on."""
    end = tick_ns(tick + 1, pmus.frame_rate)
    issued = control_step(
        bank, bank_state, ids, id_state, links.used, links.up.out, links.up.ring, given, given, -1, tick, kept
    )
    applied = 0
    for link in range(links.up.ring.shape[0]):
        arrived = downlink(links, link, tick, end, given, issued)
        applied = merge(taken, applied, links.down.out[link], arrived)
    kept.used[3] = _append(kept.applied, kept.used[3], taken, applied)
    sound = sound and not bank_state.calls.failed.any()
    if sound:
        go_on(plant, plant_state, pmus, pmu_state, tick, taken, applied, work)
    return sound


@compiled
def _step(
    plant: Plant,
    plant_state: PlantState,
    work: Work,
    pmus: Pmus,
    pmu_state: PmuState,
    links: Links,
    bank: Bank,
    bank_state: BankState,
    ids: Identifiers,
    id_state: IdentifierState,
    given: NDArray[Any],
    taken: NDArray[Any],
    kept: Signals,
    tick: int,
) -> bool:
    """`step`, with the loop's parts one by one.

    Handed over in one piece, a tuple as large as a whole loop takes the compiler several times as long: each of its
    hundreds of numbers is put into it by an instruction that spells out the type of all.
    """
    sound = _begin(plant, plant_state, work, pmus, pmu_state, links, kept, tick)
    return _end(
        plant,
        plant_state,
        work,
        pmus,
        pmu_state,
        links,
        bank,
        bank_state,
        ids,
        id_state,
        given,
        taken,
        kept,
        tick,
        sound,
    )


@released
def turn(
    plant: Plant,
    plant_state: PlantState,
    work: Work,
    pmus: Pmus,
    pmu_state: PmuState,
    links: Links,
    bank: Bank,
    bank_state: BankState,
    ids: Identifiers,
    id_state: IdentifierState,
    given: NDArray[Any],
    taken: NDArray[Any],
    kept: Signals,
    tick: int,
) -> bool:
    """From what was delivered in a tick to what is delivered in the next: its second half, the first one of the next.

    `tick`: -1 at the start. False: there is no next one, as the plant, or a controller, does not go on.
    """
    if tick >= 0 and not _end(
        plant,
        plant_state,
        work,
        pmus,
        pmu_state,
        links,
        bank,
        bank_state,
        ids,
        id_state,
        given,
        taken,
        kept,
        tick,
        kept.in_synchronism[tick],
    ):
        return False
    if tick + 1 == kept.time_ns.size:
        return False
    _begin(plant, plant_state, work, pmus, pmu_state, links, kept, tick + 1)
    return True


@compiled
def _run(
    plant: Plant,
    plant_state: PlantState,
    work: Work,
    pmus: Pmus,
    pmu_state: PmuState,
    links: Links,
    bank: Bank,
    bank_state: BankState,
    ids: Identifiers,
    id_state: IdentifierState,
    given: NDArray[Any],
    taken: NDArray[Any],
    kept: Signals,
) -> None:
    """`run_loop`, with the loop's parts one by one."""
    for tick in range(kept.time_ns.size):
        if not _step(
            plant,
            plant_state,
            work,
            pmus,
            pmu_state,
            links,
            bank,
            bank_state,
            ids,
            id_state,
            given,
            taken,
            kept,
            tick,
        ):
            break


def step(loop: Loop, tick: int) -> bool:
    """One tick of a loop, the next one of those before; False: the plant is no longer sound, and stands still.

    Raises `RunError` where a program of the user's own has failed.
    """
    sound = bool(_step(*loop[:-1], tick))
    check(loop.programs)
    return sound


def run_loop(loop: Loop) -> None:
    """All ticks from the first on, or until the plant is no longer sound.

    Raises `RunError` where a program of the user's own has failed.
    """
    _run(*loop[:-1])
    check(loop.programs)


def with_half_step(case: Case) -> Case:
    """The case with half the integrator's longest step."""
    return replace(case, system=case.system.model_copy(update={"step": case.system.step / 2}))


def run(case: Case) -> Record:
    """One closed loop in process, compiled; the record of all its signals."""
    return finish(case, build_loop(case))


def finish(case: Case, loop: Loop) -> Record:
    """Run a loop at its start to the end; it keeps the state in which it ended."""
    run_loop(loop)
    return record(case, loop)


def record(case: Case, loop: Loop) -> Record:
    """The record of what a loop has run through."""
    kept = loop.signals
    refused = int(loop.links.up.ring[:, 3].sum() + loop.links.down.ring[:, 3].sum())
    if refused:
        raise RunError(f"link: {refused} entries found no room under way; its delays are not what was allowed for")
    ticks, delivered, issued, applied, estimates, learning = (int(n) for n in kept.used)
    if delivered > kept.delivered.size or issued > kept.issued.size or applied > kept.applied.size:
        raise RunError(f"loop: {delivered} entries, {issued} setpoints, {applied} applied: more than there is room for")
    return Record(
        configuration=case.document(),
        stations=[s.name for s in case.system.stations],
        machine_names=[m.name for m in case.system.machines],
        device_names=list(case.run.devices),
        controller_names=controller_names(case),
        time_ns=kept.time_ns[:ticks],
        frames=kept.frames[:ticks],
        measured_ns=kept.measured_ns[:ticks],
        status=kept.status[:ticks],
        delivered=kept.delivered[:delivered],
        issued=kept.issued[:issued],
        applied=kept.applied[:applied],
        machines=kept.machines[:ticks],
        devices=kept.devices[:ticks],
        in_synchronism=kept.in_synchronism[:ticks],
        estimates=kept.estimates[:estimates],
        learning=kept.learning[:learning],
        links=len(case.links),
        events=[event for event in grid_events(case) if event["time_ns"] <= kept.time_ns[ticks - 1]],
    )
