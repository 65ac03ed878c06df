"""One tick of the closed loop, compiled: measure, uplink, act, learn, downlink, advance (docs/architecture.md).

The nodes call the same functions, one node each; here they run in sequence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from numpy.typing import NDArray

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import HOST, Array, Bool1, Float3, Int1, Int2, Struct
from facts_damping.control.bank import Bank, BankState, act, set_estimate
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.control.identifier_model import Identifiers, IdentifierState
from facts_damping.control.table import DIRECT, INDIRECT
from facts_damping.link.transfer import RING_DELIVERED, Links, downlink, merge, uplink
from facts_damping.neurofuzzy.learning import write_learning
from facts_damping.neurofuzzy.network import shape_of
from facts_damping.signals import (
    DELIVERY,
    DEVICE_TRUTH,
    ESTIMATE,
    LEARNING,
    MACHINE_TRUTH,
    SETPOINT,
    SUPERVISION,
    Deliveries2,
    DeviceTruths,
    Setpoints,
    Span,
)
from facts_damping.simulation.measured_plant import MeasuredPlant, advance_with_pmus, measure_with_pmus, tick_ns
from facts_damping.supervision.model import Supervisors, SupervisorState
from facts_damping.supervision.step import read_health, supervise, write_status

if TYPE_CHECKING:
    import numpy as np


class Used(NamedTuple):
    """A value for the ticks and for each table of `Signals`: number of rows filled; in `AT` its index in `used`."""

    ticks: int
    delivered: int
    issued: int
    applied: int
    estimates: int
    learning: int
    supervised: int
    supervision: int


AT = Used(*range(len(Used._fields)))


class Signals(Struct):
    """Arrays that a run fills, as in `record.Record`; `used`: number of entries filled, see `Used`."""

    time_ns: Int1
    frames: Float3
    measured_ns: Int2
    status: Int2
    machines: Annotated[NDArray[Any], Array(MACHINE_TRUTH, 2)]
    devices: Annotated[NDArray[Any], Array(DEVICE_TRUTH, 2)]
    in_synchronism: Bool1
    delivered: Annotated[NDArray[Any], Array(DELIVERY, 1)]
    issued: Annotated[NDArray[Any], Array(SETPOINT, 1)]
    applied: Annotated[NDArray[Any], Array(SETPOINT, 1)]
    estimates: Annotated[NDArray[Any], Array(ESTIMATE, 1)]
    learning: Annotated[NDArray[Any], Array(LEARNING, 1)]
    supervised: Annotated[NDArray[Any], Array(SETPOINT, 1)]
    supervision: Annotated[NDArray[Any], Array(SUPERVISION, 1)]
    used: Int1


class ControlSystem(Struct):
    """Controllers, identifiers and supervisors, and the setpoints of a tick."""

    bank: Bank
    bank_state: BankState
    identifiers: Identifiers
    identifier_state: IdentifierState
    supervisors: Supervisors
    supervisor_state: SupervisorState
    issued: Setpoints  # setpoints issued by the controllers
    passed: Setpoints  # setpoints that act, after the supervisors


class Loop(Struct):
    """All parts of a closed loop: constant parameters and state of each, and recorded signals."""

    measured: MeasuredPlant
    links: Links
    control: ControlSystem
    applied: Setpoints  # setpoints that all links deliver to the devices in a tick
    signals: Signals
    programs: Annotated[list[Any], HOST]  # `policies.Program` of user's own controllers


@compiled
def _append(table: NDArray[Any], at: int, entries: NDArray[Any], count: int) -> int:
    """Store `count` entries from index `at` on, as far as there is room; returns the index after the last."""
    for i in range(min(count, table.size - at)):
        table[at + i] = entries[i]
    return at + count


@entry_point
def control_step(
    control: ControlSystem,
    used: Int1,
    delivered: Deliveries2,
    ring: Int2,
    tick: int,
    devices: DeviceTruths,
    signals: Signals,
) -> int:
    """Run controllers on the entries delivered in a tick, then supervisors, then identifiers.

    `delivered`: (links, entries); `ring`: with the number of entries, as in `link.transfer.FrameDirection`; controller
    c uses link `used[c]`; `devices`: DEVICE_TRUTH for supervisors. Identifiers use the setpoints that act; controllers
    use the estimates in the next tick. Returns the number of setpoints that act.
    """
    bank, bank_state = control.bank, control.bank_state
    ids, id_state = control.identifiers, control.identifier_state
    issued = 0
    for c in range(bank.code.size):
        issued = act(
            bank, bank_state, c, tick, delivered[used[c]], ring[used[c], RING_DELIVERED], control.issued, issued
        )
    signals.used[AT.issued] = _append(signals.issued, signals.used[AT.issued], control.issued, issued)
    acting = issued
    if control.supervisors.settings.size == 0:
        for i in range(issued):
            control.passed[i] = control.issued[i]
    else:
        acting = _supervised(control, delivered, ring, issued, tick, devices, signals)
    rows = signals.used[AT.estimates]
    for n in range(ids.controller.size):
        c = ids.controller[n]
        identify(ids, id_state, n, delivered[used[c]], ring[used[c], RING_DELIVERED])
        store_setpoints(ids, id_state, n, control.passed, acting)
        rows = write_estimates(ids, id_state, n, tick, signals.estimates, rows)
        set_estimate(bank_state, c, id_state.jacobian[n], id_state.change[n], id_state.held.newest_ns[n])
    signals.used[AT.estimates], rows = rows, signals.used[AT.learning]
    for c in range(bank.code.size):
        if bank.code[c] == DIRECT or bank.code[c] == INDIRECT:
            net = shape_of(bank.shape[c])
            learner, fall = bank_state.learner.each[c], bank_state.memory.lyapunov[c]
            rows = write_learning(net, learner, fall, tick, c, 0, signals.learning, rows)
    for n in range(ids.controller.size):
        net = shape_of(ids.shape[n])
        learner, fall = id_state.learner.each[n], id_state.lyapunov[n]
        rows = write_learning(net, learner, fall, tick, ids.controller[n], 1, signals.learning, rows)
    signals.used[AT.learning] = rows
    return acting


@compiled
def _supervised(
    control: ControlSystem,
    delivered: NDArray[Any],
    ring: NDArray[np.int64],
    issued: int,
    tick: int,
    devices: NDArray[Any],
    signals: Signals,
) -> int:
    """Run a tick of all supervisors; returns the number of their setpoints."""
    supervisors, state, acting = control.supervisors, control.supervisor_state, 0
    for s in range(supervisors.settings.size):
        settings = supervisors.settings[s]
        span = Span(tick, tick_ns(tick, settings.frame_rate), tick_ns(tick + 1, settings.frame_rate))
        read_health(control.bank, control.bank_state, settings.controller, state.rows[s])
        rows = delivered[settings.link, : ring[settings.link, RING_DELIVERED]]
        setpoints, free = control.issued[:issued], control.passed[acting:]
        acting += supervise(supervisors, state, s, span, rows, setpoints, devices, free)
        if write_status(supervisors, state, s, tick, signals.supervision, signals.used[AT.supervision]):
            signals.used[AT.supervision] += 1
    signals.used[AT.supervised] = _append(signals.supervised, signals.used[AT.supervised], control.passed, acting)
    return acting


@entry_point
def run_half_ticks(loop: Loop, first: int, until: int) -> bool:
    """Run half ticks from `first` to before `until`; returns False if the plant or a controller has stopped.

    Half tick 2 k: PMUs measure at tick k, and uplinks deliver. Half tick 2 k + 1: controllers act, supervisors forward,
    identifiers learn, downlinks deliver, and the plant advances.
    """
    measured, links, control, trace = loop.measured, loop.links, loop.control, loop.signals
    several, rate = links.up.ring.shape[0], measured.pmus.frame_rate
    for half in range(first, until):
        tick = half // 2
        start, end = tick_ns(tick, rate), tick_ns(tick + 1, rate)
        if half % 2 == 0:
            frame, measured_ns, status = trace.frames[tick], trace.measured_ns[tick], trace.status[tick]
            machines, devices = trace.machines[tick], trace.devices[tick]
            sound = measure_with_pmus(measured, tick, frame, measured_ns, status, machines, devices)
            trace.time_ns[tick] = start
            trace.in_synchronism[tick] = sound
            trace.used[AT.ticks] = tick + 1
            for link in range(several):
                delivered = uplink(links, link, tick, start, end, frame, measured_ns, status)
                rows = links.up.out[link]
                trace.used[AT.delivered] = _append(trace.delivered, trace.used[AT.delivered], rows, delivered)
            continue
        acting = control_step(control, links.used, links.up.out, links.up.ring, tick, trace.devices[tick], trace)
        applied = 0
        for link in range(several):
            arrived = downlink(links, link, tick, end, control.passed, acting)
            applied = merge(loop.applied, applied, links.down.out[link], arrived)
        trace.used[AT.applied] = _append(trace.applied, trace.used[AT.applied], loop.applied, applied)
        if not trace.in_synchronism[tick] or control.bank_state.calls.failed.any():
            return False
        advance_with_pmus(measured, tick, loop.applied, applied)
    return True
