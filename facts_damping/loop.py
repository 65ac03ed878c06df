"""The closed loop without ROS: one compiled tick of everything, and whole runs of it.

The order of a tick (docs/architecture.md): measure, uplink, act, downlink, advance. The nodes call
the same five functions, each its own; here they are called in one compiled loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.control.bank import Bank, BankState, act, bank, network_of, settings
from facts_damping.control.identifier import (
    Identified,
    Identifiers,
    IdentifierState,
    identifiers,
    identify,
    remember,
    tell,
)
from facts_damping.control.identifier import network_of as identifier_network_of
from facts_damping.errors import InputError, RunError
from facts_damping.link.transfer import Direction, directions, downlink, uplink
from facts_damping.parameters.run import Controller, Weights
from facts_damping.plant.build import Built, build
from facts_damping.plant.events import timeline
from facts_damping.plant.integration import advance
from facts_damping.plant.measurement import measure
from facts_damping.plant.model import Plant, PlantState, Work, workspace
from facts_damping.sensitivity import Sensitivity, sensitivities
from facts_damping.signals import (
    CHANNELS,
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    MACHINE_TRUTH,
    NANOSECONDS,
    SETPOINT,
    Record,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.configuration import Case
    from facts_damping.neurofuzzy.network import Network


class Loop(NamedTuple):
    """Everything a closed loop consists of: frozen parameters and state, each part by itself."""

    plant: Plant
    plant_state: PlantState
    work: Work
    up: Direction
    down: Direction
    bank: Bank
    bank_state: BankState
    identifiers: Identifiers
    identifier_state: IdentifierState
    issued: NDArray[Any]  # SETPOINT, what the controllers issue in a tick


class Signals(NamedTuple):
    """Arrays that a run fills: see `signals.Record`; `used` holds ticks, delivered, issued, applied, estimates."""

    time_ns: NDArray[np.int64]
    frames: NDArray[np.float64]
    machines: NDArray[Any]
    devices: NDArray[Any]
    in_synchronism: NDArray[np.bool_]
    delivered: NDArray[Any]
    issued: NDArray[Any]
    applied: NDArray[Any]
    estimates: NDArray[Any]
    used: NDArray[np.int64]


@compiled
def tick_ns(tick: int, frame_rate: int) -> int:
    """Time of a tick, ns: t_k = k / f, rounded down."""
    return tick * NANOSECONDS // frame_rate


def commands(case: Case) -> int:
    """Number of setpoints that all controllers of a case give at one arrival."""
    return sum(len(controller.devices) for controller in case.controllers)


def derivatives(case: Case) -> int:
    """Number of derivatives that all identifiers of a case estimate."""
    return sum(len(c.devices) * len(c.signals) for c in case.controllers if c.scheme == "indirect")


def build_plant(case: Case) -> Built:
    """The plant of a case, at its equilibrium."""
    return build(case.system, case.run.devices, case.scenario.events)


def build_link(case: Case) -> tuple[Direction, Direction]:
    """Both directions of a case's link."""
    stations, devices = len(case.system.stations), len(case.run.devices)
    return directions(case.link, stations, devices, commands(case), case.run.frame_rate)


def build_control(
    case: Case, known: dict[tuple[str, str], Sensitivity] | None = None
) -> tuple[Bank, BankState, Identifiers, IdentifierState]:
    """Controllers and identifiers of a case; `known`: its sensitivities, where they are at hand.

    Raises `InputError` where the sign of a neuro-fuzzy controller's sensitivity is not the plant's.
    """
    devices = [next(d for d in case.system.devices if d.name == name) for name in case.run.devices]
    limits = {d.name: (d.v_max, d.rate_max) for d in devices}
    stations = [station.name for station in case.system.stations]
    if known is None and any(c.scheme for c in case.controllers):
        start = build(case.system, case.run.devices, [])
        known = sensitivities(start, case.system, case.run.devices, case.run.frame_rate)
    known = known or {}
    signs = _signs(case, known)
    rate = case.run.frame_rate
    made, state = bank(case.controllers, case.system.signals, stations, limits, rate, signs)
    rows = [
        Identified(
            i,
            settings(c),
            str(c.parameters["identifier"]),
            c.signals,
            [case.run.devices.index(device) for device in c.devices],
            [limits[device][0] for device in c.devices],
            np.array([[known[s, d].sign * abs(known[s, d].frame) for d in c.devices] for s in c.signals]),
            np.array(c.weights.identifier) if isinstance(c.weights, Weights) and c.weights.identifier else None,
        )
        for i, c in enumerate(case.controllers)
        if c.scheme == "indirect"
    ]
    return made, state, *identifiers(rows, case.system.signals, stations, rate)


def _signs(case: Case, known: dict[tuple[str, str], Sensitivity]) -> dict[tuple[str, str], float]:
    """Signs of dy/du for all signals and devices of neuro-fuzzy controllers."""
    signs = {}
    for i, c in enumerate(case.controllers):
        for signal in c.signals if c.scheme else ():
            for device in c.devices:
                here = f"controllers.{i}.parameters.sensitivity"
                if (signal, device) not in known:
                    raise InputError(f"{here}: the plant has no swing mode; allowed: a controller without adaptation")
                plant, given = known[signal, device], float(c.parameters["sensitivity"])
                why = (
                    f"the residue from {device} to {signal} at the least damped mode ({plant.frequency_hz:.2f} Hz) "
                    f"has an angle of {plant.angle_deg:.0f} degrees"
                )
                if plant.sign == 0.0:
                    raise InputError(f"{here}: none fits; {why}, near neither 0 nor 180; allowed: another signal")
                if given not in (0.0, plant.sign):
                    raise InputError(f"{here}: {given:g} given; allowed: {plant.sign:g} (or 0, to take it): {why}")
                signs[signal, device] = plant.sign
    return signs


def issue_room(commands: int, entries: int) -> NDArray[Any]:
    """Room for the setpoints of a tick: `commands` at each arrival, and each delivered entry may be one."""
    return np.zeros(commands * entries, SETPOINT)


def build_loop(case: Case, known: dict[tuple[str, str], Sensitivity] | None = None) -> Loop:
    """All parts of a case, at the start; `known` as for `build_control`."""
    built = build_plant(case)
    up, down = build_link(case)
    control = build_control(case, known)
    work = workspace(built.plant, built.state)
    issued = issue_room(commands(case), len(up.out))
    return Loop(built.plant, built.state, work, up, down, *control, issued)


def room(case: Case, loop: Loop, ticks: int | None = None) -> Signals:
    """Arrays for all signals of a case, or of its first `ticks`."""
    n, stations = case.ticks if ticks is None else ticks, len(case.system.stations)
    setpoints = 2 * commands(case)
    return Signals(
        np.zeros(n, np.int64),
        np.zeros((n, stations, len(CHANNELS))),
        np.zeros((n, len(loop.plant.machines)), MACHINE_TRUTH),
        np.zeros((n, len(loop.plant.devices)), DEVICE_TRUTH),
        np.zeros(n, np.bool_),
        np.zeros(n * stations, DELIVERY),
        np.zeros(n * setpoints, SETPOINT),
        np.zeros(n * setpoints, SETPOINT),
        np.zeros(n * derivatives(case), ESTIMATE),
        np.zeros(5, np.int64),
    )


@compiled
def _append(kept: NDArray[Any], at: int, entries: NDArray[Any], count: int) -> int:
    """Keep `count` entries from index `at` on; the index after the last."""
    for i in range(count):
        kept[at + i] = entries[i]
    return at + count


@compiled
def learn_tick(loop: Loop, tick: int, delivered: int, issued: int, estimates: NDArray[Any], at: int) -> int:
    """All identifiers' tick: learn from what was delivered and issued before, then take in what is issued now.

    The controllers use the estimate of the tick before. Returns the index after the last row of `estimates`.
    """
    ids, state = loop.identifiers, loop.identifier_state
    for n in range(ids.controller.size):
        identify(ids, state, n, loop.up.out, delivered)
        remember(ids, state, n, loop.issued, issued)
        at = tell(ids, state, n, tick, estimates, at)
        serve(loop.bank_state.jacobian[ids.controller[n]], state.jacobian[n])
    return at


@compiled
def serve(held: NDArray[np.float64], estimate: NDArray[np.float64]) -> None:
    """Hand an estimate to a controller, for its next tick."""
    for i in range(estimate.shape[0]):
        for d in range(estimate.shape[1]):
            held[i, d] = estimate[i, d]


@compiled
def run_loop(loop: Loop, frame_rate: int, ticks: int, kept: Signals) -> None:
    """Run `ticks` ticks, or until the plant is no longer sound."""
    for k in range(ticks):
        start, end = tick_ns(k, frame_rate), tick_ns(k + 1, frame_rate)
        frame = kept.frames[k]
        sound = measure(loop.plant, loop.plant_state, start, frame, kept.machines[k], kept.devices[k], loop.work)
        kept.time_ns[k] = start
        kept.in_synchronism[k] = sound
        kept.used[0] = k + 1
        delivered = uplink(loop.up, k, start, end, frame)
        kept.used[1] = _append(kept.delivered, kept.used[1], loop.up.out, delivered)
        issued = 0
        for c in range(loop.bank.code.size):
            issued = act(loop.bank, loop.bank_state, c, k, loop.up.out, delivered, loop.issued, issued)
        kept.used[2] = _append(kept.issued, kept.used[2], loop.issued, issued)
        applied = downlink(loop.down, k, end, loop.issued, issued)
        kept.used[3] = _append(kept.applied, kept.used[3], loop.down.out, applied)
        kept.used[4] = learn_tick(loop, k, delivered, issued, kept.estimates, kept.used[4])
        if not sound:
            break
        advance(loop.plant, loop.plant_state, start, end, loop.down.out, applied, loop.work)


def run(case: Case) -> Record:
    """One closed loop in process, compiled; the record of all its signals."""
    return finish(case, build_loop(case))


def finish(case: Case, loop: Loop) -> Record:
    """Run a loop at its start to the end; it keeps the state in which it ended."""
    kept = room(case, loop)
    run_loop(loop, case.run.frame_rate, case.ticks, kept)
    lost = int(loop.up.statistics["lost"].sum() + loop.down.statistics["lost"].sum())
    if lost:
        raise RunError(f"link: {lost} entries found no room under way; its longest delay is not what was allowed for")
    ticks, delivered, issued, applied, estimates = (int(n) for n in kept.used)
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
        events=[event for event in grid_events(case) if event["time_ns"] <= kept.time_ns[ticks - 1]],
    )


def rehearse(case: Case) -> None:
    """Call every function of a tick once, as the nodes do, on a state that is thrown away.

    Compiles them, or loads them from the cache, before a clock runs.
    """
    loop = build_loop(case)
    kept = room(case, loop, 1)
    end = tick_ns(1, case.run.frame_rate)
    measure(loop.plant, loop.plant_state, 0, kept.frames[0], kept.machines[0], kept.devices[0], loop.work)
    delivered = uplink(loop.up, 0, 0, end, kept.frames[0])
    issued = 0
    for c in range(len(case.run.controllers)):
        issued = act(loop.bank, loop.bank_state, c, 0, loop.up.out, delivered, loop.issued, issued)
    for n in range(len(loop.identifiers.controller)):
        identify(loop.identifiers, loop.identifier_state, n, loop.up.out, delivered)
        remember(loop.identifiers, loop.identifier_state, n, loop.issued, issued)
        tell(loop.identifiers, loop.identifier_state, n, 0, kept.estimates, 0)
    applied = downlink(loop.down, 0, end, loop.issued, issued)
    advance(loop.plant, loop.plant_state, 0, end, loop.down.out, applied, loop.work)


def adapted(
    controller: Controller, index: int, state: BankState | None, identifier: tuple[int, IdentifierState] | None
) -> Weights | None:
    """What a controller (its place and state) and its identifier have learnt; none for one that does not learn."""
    if controller.scheme is None:
        return None
    own = learnt = None
    if state is not None:
        own = state.learner.theta[index, : network_of(controller).size].tolist()
    if identifier is not None:
        n, found = identifier
        learnt = found.learner.theta[n, : identifier_network(controller).size].tolist()
    return Weights(name=controller.name, scheme=controller.scheme, controller=own, identifier=learnt)


def all_adapted(case: Case, loop: Loop) -> dict[str, Weights]:
    """What all controllers of a loop have learnt, by their names as nodes."""
    serving = loop.identifiers.controller.tolist()
    found = {}
    for i, (name, controller) in enumerate(zip(controller_names(case), case.controllers, strict=True)):
        identifier = (serving.index(i), loop.identifier_state) if i in serving else None
        weights = adapted(controller, i, loop.bank_state, identifier)
        if weights is not None:
            found[name] = weights
    return found


def identifier_network(controller: Controller) -> Network:
    """The network of a controller's identifier."""
    kind = str(controller.parameters["identifier"])
    return identifier_network_of(kind, len(controller.signals), len(controller.devices))


def controller_names(case: Case) -> list[str]:
    """Names of the controllers as nodes: their place in the run and their kind, `controller_0_LLC`."""
    return [f"controller_{c}_{re_name(controller.name)}" for c, controller in enumerate(case.run.controllers)]


def identifier_names(case: Case) -> dict[int, str]:
    """Names of the identifiers as nodes, by the index of the controller that each serves: `identifier_0_ANFTSI`."""
    return {
        c: f"identifier_{c}_{controller.parameters['identifier']}"
        for c, controller in enumerate(case.controllers)
        if controller.scheme == "indirect"
    }


def re_name(kind: str) -> str:
    """A kind's name as a ROS name: letters, digits and underscores."""
    return "".join(letter if letter.isalnum() else "_" for letter in kind)


def grid_events(case: Case) -> list[dict[str, Any]]:
    """All changes of the grid in order of time, as they are published: time_ns, kind, element, value, location."""
    found = []
    for change in timeline(case.scenario.events):
        row = change.event.model_dump()
        element = next(row[key] for key in ("line", "bus", "load", "machine") if row.get(key) is not None)
        on_line = row["kind"] == "fault" and row.get("line") is not None
        found.append(
            {
                "time_ns": change.time_ns,
                "kind": row["kind"],
                "element": element,
                "value": row.get("change", float("nan")),
                "location": row["location"] if on_line else float("nan"),
            }
        )
    return found
