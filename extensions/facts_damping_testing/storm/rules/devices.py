"""Rules about what acts on devices: setpoints, limits, trips, arming."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.case.names import served
from facts_damping.monitor_table import TRIPPED
from facts_damping.nodes.launching.starting import PLANT
from facts_damping.recording.events import FAILED, STOPPED
from facts_damping_studies.campaigns import invariants
from facts_damping_testing.attacker import SWING
from facts_damping_testing.storm.rules.foreign import may_be_replaced
from facts_damping_testing.storm.storm_graph import MARK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record
    from facts_damping_testing.storm.running import Trace


SENDS = {"controller": "issued", "link": "applied"}  # table with the setpoints of a role
ENDS = "the run has ended: "
LEAVE = ("reset", "disarm", "start")  # after a trip; a supervisor that starts again knows of none, and is in shadow


def nothing_foreign_acts(trace: Trace) -> list[str]:
    """No forged setpoint is passed on, applied or in force, no forged frame delivered, no forged end believed."""
    record, found = trace.record, list[str]()
    if record is None or may_be_replaced(trace):
        return []
    forged = [trace.case.system.device(name).setpoint_max * MARK for name in trace.case.run.devices]
    for what in ("issued", "supervised", "applied"):
        rows = getattr(record, what)
        if len(rows) and np.isclose(np.abs(rows["value"]), np.array(forged)[rows["device"]], rtol=1e-14, atol=0).any():
            found.append(f"a forged setpoint is {what}")
    if forged and np.isclose(np.abs(record.devices["setpoint"]), forged, rtol=1e-14, atol=0).any():
        found.append("a forged setpoint is in force")
    if len(record.delivered) and np.all(np.abs(record.delivered["values"]) == SWING, axis=1).any():
        found.append("a forged frame is delivered")
    ends = {text for _, name, _, text in trace.logs if name == PLANT} | {STOPPED}
    told = {text.removeprefix(ENDS) for _, _, _, text in trace.logs if text.startswith(ENDS)}
    if trace.mode != "free":
        found += [f"nodes believe that the run has ended: {text}" for text in sorted(told - ends) if FAILED not in text]
    return found


def device_is_released(trace: Trace) -> list[str]:
    """A device is at zero within time-out and ramp after the last setpoint that its watchdog accepted."""
    if trace.record is None or _plant_changed(trace.record) or may_be_replaced(trace):
        return []
    late = 0 if trace.mode == "lockstep" else 3 + _pauses(trace.record)
    holds = invariants.holds(invariants.lets_go(trace.case, trace.record, late))
    return [] if holds else ["a device keeps its setpoint"]


def _plant_changed(record: Record) -> bool:
    """Whether an operator replaced the plant's state, so that what came before counts no longer."""
    return any(one.kind in ("reset", "rearm", "release") for one in record.changes)


def _pauses(record: Record) -> int:
    """Ticks by which setpoints may act late, as the plant was paused."""
    return len(record.ticks) if any(one.kind in ("pause", "step") for one in record.changes) else 0


def setpoints_are_limited(trace: Trace) -> list[str]:
    """Setpoints and references stay within the device's limit, authority and rate."""
    if trace.record is None or _plant_changed(trace.record) or may_be_replaced(trace):
        return []
    holds = invariants.holds(invariants.limits(trace.case, trace.record))
    return [] if holds else ["a setpoint or a reference exceeds its limits"]


def trips_hold(trace: Trace) -> list[str]:
    """What was tripped stays tripped, and passes nothing but its ramp, until an operator resets or disarms it."""
    record, found = trace.record, []
    if record is None or trace.case.supervision is None or may_be_replaced(trace):
        return []
    ramp = trace.case.supervision.arming.trip_ramp
    for c in np.unique(record.supervision["controller"]).tolist():
        asked = {(one.index, one.tick) for one in record.changes if one.role == "supervisor" and one.kind in LEAVE}
        rows = record.supervision[record.supervision["controller"] == c]
        passed = record.supervised[record.supervised["controller"] == c]
        left = np.flatnonzero((rows["state"][:-1] == TRIPPED) & (rows["state"][1:] != TRIPPED))
        for at in left.tolist():
            begin, end = int(rows["tick"][at]), int(rows["tick"][at + 1])
            if not any(index == c and begin < tick <= end for index, tick in asked):
                found.append(f"supervisor {c} leaves its trip at tick {end} although no one asked")
        found += _acts_after_trip(rows, passed, ramp, record.frame_rate, c)
    return found


def _acts_after_trip(rows: NDArray[np.void], passed: NDArray[np.void], ramp: float, rate: int, c: int) -> list[str]:
    tripped = rows["tick"][rows["state"] == TRIPPED]
    if not len(tripped):
        return []
    since = np.array([_since(tripped, tick) for tick in passed["tick"].tolist()])
    late = (since > ramp * rate + 2) & (passed["value"] != 0.0)
    ticks = passed["tick"][late]
    return [f"supervisor {c} passes a setpoint at tick {int(ticks[0])}, though tripped"] if late.any() else []


def _since(tripped: NDArray[np.int64], tick: int) -> int:
    """For how many ticks without a break it has been tripped at a tick; -1: it is not."""
    at = int(np.searchsorted(tripped, tick))
    if at == len(tripped) or tripped[at] != tick:
        return -1
    run = tripped[: at + 1]
    breaks = np.flatnonzero(np.diff(run) != 1)
    return tick - int(run[breaks[-1] + 1] if len(breaks) else run[0])


def restarted_nodes_are_disarmed(trace: Trace) -> list[str]:
    """A controller or link that was started again, with `join`, sends no setpoint until an operator arms it."""
    record, storm = trace.record, trace.storm
    if record is None or storm is None or may_be_replaced(trace):
        return []
    killed_at = {f"/{one.node}": one.tick for one in reversed(trace.timeline) if one.kind == "restarted"}
    found = []
    for one in [one for one in record.changes if one.kind == "start" and one.role in SENDS]:
        if one.value != "disarmed":
            if one.tick > killed_at.get(one.node, 10**9):
                found.append(f"{one.node} starts again at tick {one.tick}, and is armed")
            continue
        later = [row.tick for row in record.changes if row.node == one.node and row.kind in ("arm", "start")]
        end = min([tick for tick in later if tick > one.tick], default=10**9)
        rows = getattr(record, SENDS[one.role])
        own = [one.index] if one.role == "controller" else served(trace.case, one.index)
        sent = np.isin(rows["controller"], own) & (rows["tick"] >= one.tick) & (rows["tick"] < end)
        found += [f"{one.node} sends setpoints, though disarmed since tick {one.tick}"] if sent.any() else []
    return found
