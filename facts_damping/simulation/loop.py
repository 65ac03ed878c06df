"""The closed loop without ROS: one compiled tick of everything, and whole runs of it.

The order of a tick (docs/architecture.md): measure, uplink, act, downlink, learn, advance. The nodes call
the same functions, each its own; here they are called in one compiled loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.case.names import controller_names
from facts_damping.compiling import compiled, inner
from facts_damping.control.bank import Bank, BankState, act, serve
from facts_damping.control.identifier import identify, remember, tell
from facts_damping.control.table import DIRECT, INDIRECT
from facts_damping.errors import RunError
from facts_damping.link.chain import SPOOF
from facts_damping.link.transfer import Links, downlink, merge, uplink
from facts_damping.neurofuzzy.learning import one, rates_told
from facts_damping.neurofuzzy.network import shape_of
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import Plant, PlantState, Work, workspace
from facts_damping.signals import (
    CHANNELS,
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    LEARNING,
    MACHINE_TRUTH,
    NANOSECONDS,
    SETPOINT,
    Record,
)
from facts_damping.simulation.build import (
    build_control,
    build_links,
    build_plant,
    commands,
    derivatives,
    grid_events,
    learning_rates,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.identifier_model import Identifiers, IdentifierState
    from facts_damping.plant.build import Built
    from facts_damping.small_signal.residues import Sensitivity


class Loop(NamedTuple):
    """Everything a closed loop consists of: frozen parameters and state, each part by itself."""

    plant: Plant
    plant_state: PlantState
    work: Work
    links: Links
    bank: Bank
    bank_state: BankState
    identifiers: Identifiers
    identifier_state: IdentifierState
    issued: NDArray[Any]  # SETPOINT, what the controllers issue in a tick
    applied: NDArray[Any]  # SETPOINT, what all links deliver to the devices in a tick


class Signals(NamedTuple):
    """Arrays that a run fills: see `signals.Record`; `used` holds ticks and the rows of the tables, in this order."""

    time_ns: NDArray[np.int64]
    frames: NDArray[np.float64]
    machines: NDArray[Any]
    devices: NDArray[Any]
    in_synchronism: NDArray[np.bool_]
    delivered: NDArray[Any]
    issued: NDArray[Any]
    applied: NDArray[Any]
    estimates: NDArray[Any]
    learning: NDArray[Any]
    used: NDArray[np.int64]


@compiled
def tick_ns(tick: int, frame_rate: int) -> int:
    """Time of a tick, ns: t_k = k / f, rounded down."""
    return tick * NANOSECONDS // frame_rate


def issue_room(commands: int, entries: int) -> NDArray[Any]:
    """Room for the setpoints of a tick: `commands` at each arrival, and each delivered entry may be one."""
    return np.zeros(commands * entries, SETPOINT)


def build_loop(case: Case, sensitivity: Sensitivity | None = None, built: Built | None = None) -> Loop:
    """All parts of a case, at the start; `sensitivity`: the plant's, as for `build_control`.

    `built`: its plant, where it is at hand; the loop takes its state over.
    """
    built = build_plant(case) if built is None else built
    links = build_links(case)
    control = build_control(case, sensitivity)
    work = workspace(built.plant, built.state)
    issued = issue_room(commands(case), links.up.out.shape[1])
    applied = np.zeros(links.down.out.size, SETPOINT)
    return Loop(built.plant, built.state, work, links, *control, issued, applied)


def room(case: Case, loop: Loop, ticks: int | None = None) -> Signals:
    """Arrays for all signals of a case, or of its first `ticks`."""
    n, stations = case.ticks if ticks is None else ticks, len(case.system.stations)
    up, down = loop.links.up, loop.links.down
    stamps = stations if (up.chain.rows["model"] == SPOOF).any() else 1  # a controller acts at each that is new
    setpoints = 2 * commands(case) * stamps
    return Signals(
        np.zeros(n, np.int64),
        np.zeros((n, stations, len(CHANNELS))),
        np.zeros((n, len(loop.plant.machines)), MACHINE_TRUTH),
        np.zeros((n, len(loop.plant.devices)), DEVICE_TRUTH),
        np.zeros(n, np.bool_),
        np.zeros(n * stations * len(case.links) * up.packets.now_ns.shape[1], DELIVERY),
        np.zeros(n * setpoints, SETPOINT),
        np.zeros(n * setpoints * down.packets.now_ns.shape[1], SETPOINT),
        np.zeros(n * derivatives(case), ESTIMATE),
        np.zeros(n * learning_rates(case), LEARNING),
        np.zeros(6, np.int64),
    )


@inner
def _append(kept: NDArray[Any], at: int, entries: NDArray[Any], count: int) -> int:
    """Keep `count` entries from index `at` on, as far as there is room; the index after the last."""
    for i in range(min(count, kept.size - at)):
        kept[at + i] = entries[i]
    return at + count


@compiled
def _run_parts(
    plant: Plant,
    plant_state: PlantState,
    work: Work,
    links: Links,
    bank: Bank,
    bank_state: BankState,
    ids: Identifiers,
    id_state: IdentifierState,
    given: NDArray[Any],
    taken: NDArray[Any],
    frame_rate: int,
    ticks: int,
    kept: Signals,
) -> None:
    """`run_loop`, with the loop's parts one by one; identifiers' estimates are used in the tick after.

    Handed over in one piece, a tuple as large as a whole loop takes the compiler several times as long: each of its
    hundreds of numbers is put into it by an instruction that spells out the type of all.
    """
    several = links.up.ring.shape[0]
    for k in range(ticks):
        start, end = tick_ns(k, frame_rate), tick_ns(k + 1, frame_rate)
        frame = kept.frames[k]
        sound = measure(plant, plant_state, start, frame, kept.machines[k], kept.devices[k], work)
        kept.time_ns[k] = start
        kept.in_synchronism[k] = sound
        kept.used[0] = k + 1
        for link in range(several):
            delivered = uplink(links, link, k, start, end, frame)
            kept.used[1] = _append(kept.delivered, kept.used[1], links.up.out[link], delivered)
        issued = 0
        for c in range(bank.code.size):
            link = links.used[c]
            issued = act(bank, bank_state, c, k, links.up.out[link], links.up.ring[link, 2], given, issued)
        kept.used[2] = _append(kept.issued, kept.used[2], given, issued)
        applied = 0
        for link in range(several):
            arrived = downlink(links, link, k, end, given, issued)
            applied = merge(taken, applied, links.down.out[link], arrived)
        kept.used[3] = _append(kept.applied, kept.used[3], taken, applied)
        rows = kept.used[4]
        for n in range(ids.controller.size):
            c = ids.controller[n]
            link = links.used[c]
            identify(ids, id_state, n, links.up.out[link], links.up.ring[link, 2])
            remember(ids, id_state, n, given, issued)
            rows = tell(ids, id_state, n, k, kept.estimates, rows)
            serve(bank_state, c, id_state.jacobian[n], id_state.change[n], id_state.held.newest_ns[n])
        kept.used[4], rows = rows, kept.used[5]
        for c in range(bank.code.size):
            if bank.code[c] == DIRECT or bank.code[c] == INDIRECT:
                net = shape_of(bank.shape[c])
                own, fall = one(bank_state.learner, c, net), bank_state.memory.lyapunov[c]
                rows = rates_told(net, own, fall, k, c, 0, kept.learning, rows)
        for n in range(ids.controller.size):
            net = shape_of(ids.shape[n])
            own, fall = one(id_state.learner, n, net), id_state.lyapunov[n]
            rows = rates_told(net, own, fall, k, ids.controller[n], 1, kept.learning, rows)
        kept.used[5] = rows
        if not sound:
            break
        advance(plant, plant_state, start, end, taken, applied, work)


def run_loop(loop: Loop, frame_rate: int, ticks: int, kept: Signals) -> None:
    """Run `ticks` ticks, or until the plant is no longer sound."""
    _run_parts(*loop, frame_rate, ticks, kept)


def run(case: Case) -> Record:
    """One closed loop in process, compiled; the record of all its signals."""
    return finish(case, build_loop(case))


def finish(case: Case, loop: Loop) -> Record:
    """Run a loop at its start to the end; it keeps the state in which it ended."""
    kept = room(case, loop)
    run_loop(loop, case.run.frame_rate, case.ticks, kept)
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
