"""Invariants that must hold for every draw of a fault campaign, and the actions of a supervisor, from the records."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import is_stable
from facts_damping.monitor_table import ARMED, CODES, FALLBACK, NO_CAUSE, TRIPPED, cause_name
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.signals import Record

TOLERANCE = 1e-9  # p.u., for a reference at zero or at its limit
SETTLED_S = 1.0  # after the ramp of a trip: pending setpoints have arrived, and the device has followed
HARM = 1.05  # ITAE relative to no control


def limits(case: Case, record: Record, _late: int = 0) -> bool:
    """Setpoints stay within the device's limit and the authority, references within limit and rate."""
    fraction = case.supervision.authority.fraction if case.supervision else 1.0
    for d, name in enumerate(case.run.devices):
        device = case.system.device(name)
        passed = record.supervised["value"][record.supervised["device"] == d]
        reference = record.devices["reference"][:, d]
        steps = np.abs(np.diff(reference)) - device.rate_max * np.diff(record.time_s)
        if not (
            np.all(np.abs(passed) <= device.setpoint_max * fraction + TOLERANCE)
            and np.all(np.abs(reference) <= device.setpoint_max + TOLERANCE)
            and np.all(steps <= TOLERANCE)
        ):
            return False
    return True


def late_ticks(record: Record, deadline_misses: int) -> int:
    """Upper bound of the ticks by which a setpoint acted after its `effective` time, in a graph in real time.

    A tick without the link's output is a deadline miss; misses after the last delivery delay nothing.
    """
    answered = int(record.delivered["tick"].max(initial=0))
    return max(0, deadline_misses - (int(record.ticks[-1]) - answered))


def lets_go(case: Case, record: Record, late: int = 0) -> bool:
    """The reference is zero within the time-out and the ramp after the last accepted setpoint."""
    watchdog = case.run.watchdog
    if watchdog is None:
        return True
    for d, name in enumerate(case.run.devices):
        reference, setpoint_max = record.devices["reference"][:, d], case.system.device(name).setpoint_max
        accepted = _accepted(record, d, setpoint_max, watchdog.max_age)
        if not len(accepted):
            continue
        newest = np.searchsorted(accepted, record.time_ns, side="right") - 1
        since = (record.time_ns - accepted[np.maximum(newest, 0)]) / NANOSECONDS
        allowed = watchdog.timeout + setpoint_max / watchdog.release_rate + (2.0 + late) / record.frame_rate
        if np.any(np.abs(reference[(newest >= 0) & (since > allowed)]) > TOLERANCE):
            return False
    return True


def _accepted(record: Record, d: int, setpoint_max: float, max_age: float) -> NDArray[np.int64]:
    """Times at which a device's watchdog may have accepted a setpoint, ns; an independent form of `plant.watchdog`."""
    rows = record.applied[record.applied["device"] == d]
    age = (rows["effective_ns"] - rows["measured_ns"]) / NANOSECONDS
    frame = 1.0 / record.frame_rate
    fit = (np.abs(rows["value"]) <= setpoint_max) & (age <= max_age) & (age >= -frame)
    return np.asarray(rows["effective_ns"][fit])


def _first_trips(record: Record) -> dict[int, int]:
    """First tick in which a supervised controller was tripped, for each that was."""
    tripped = record.supervision[record.supervision["state"] == TRIPPED]
    controllers, first = np.unique(tripped["controller"], return_index=True)
    return dict(zip(controllers.tolist(), tripped["tick"][first].tolist(), strict=True))


def _trip_ramp_s(case: Case) -> float:
    return case.supervision.arming.trip_ramp if case.supervision else 0.0


def zero_after_trip(case: Case, record: Record, _late: int = 0) -> bool:
    """After a trip and its ramp, the supervisor sends zero until the end of the run, even after a restart."""
    status, passed = record.supervision, record.supervised
    for c, tick in _first_trips(record).items():
        after = (tick / record.frame_rate + _trip_ramp_s(case)) * NANOSECONDS + 2 * NANOSECONDS / record.frame_rate
        acts = passed["value"][(passed["controller"] == c) & (passed["issued_ns"] > after)] != 0.0
        states = status["state"][(status["controller"] == c) & (status["tick"] >= tick)]
        if acts.any() or np.isin(states, (ARMED, FALLBACK)).any():
            return False
    return True


def device_at_zero(case: Case, record: Record, late: int = 0) -> bool:
    """After a trip, and after pending setpoints have arrived, the device's reference is zero."""
    for c, tick in _first_trips(record).items():
        after = record.time_s > (tick + late) / record.frame_rate + _trip_ramp_s(case) + SETTLED_S
        for name in case.controllers[c].devices:
            if np.any(np.abs(record.devices["reference"][after, case.run.devices.index(name)]) > TOLERANCE):
                return False
    return True


def causes(_case: Case, record: Record, _late: int = 0) -> bool:
    """Every trip has a recorded cause."""
    return bool(np.all(record.supervision["cause"][record.supervision["state"] == TRIPPED] >= 0))


def alone(case: Case, record: Record, late: int = 0) -> dict[str, bool]:
    """Invariants of a single record by column; `late`: ticks by which setpoints may have acted too late."""
    return {name: holds(case, record, late) for name, holds in ALONE.items()}


# Invariants of a single record, by column of the table.
ALONE: dict[str, Callable[[Case, Record, int], bool]] = {
    "within_limits": limits,
    "lets_go": lets_go,
    "zero_after_trip": zero_after_trip,
    "device_at_zero": device_at_zero,
    "cause_recorded": causes,
}
BESIDE = ("keeps_synchronism", "does_no_harm")  # relative to a run without control
INVARIANTS = (*ALONE, *BESIDE)


def itae(record: Record) -> float | None:
    """ITAE of a run, p.u. s^2; None if it loses synchronism."""
    if is_stable(record) is not True:
        return None
    return performance_indices(record.time_s, columns(speed_differences(record)))["ITAE"]


def lost_s(record: Record) -> float | None:
    """Time of the loss of synchronism, s; or None."""
    lost = np.flatnonzero(~record.in_synchronism)
    return float(record.time_s[lost[0]]) if len(lost) else None


def beside(record: Record, uncontrolled: Record) -> dict[str, Any]:
    """Figures of a run relative to the same without control.

    If that one falls out of step, control cannot make it worse: both conditions are None. If it does not, a run that
    falls out of step violates both. A ratio exists if neither does.
    """
    own, none = itae(record), itae(uncontrolled)
    lost, none_lost = lost_s(record), lost_s(uncontrolled)
    return {
        "lost_s": lost,
        "uncontrolled_lost_s": none_lost,
        "ITAE": own,
        "uncontrolled_ITAE": none,
        "ratio": own / none if own is not None and none else None,
        "keeps_synchronism": None if none_lost is not None else lost is None,
        "does_no_harm": None if none is None else own is not None and own <= HARM * none,
    }


def doings(record: Record, start_s: float) -> dict[str, Any]:
    """Actions of a supervisor: when it was armed, tripped and fell back, why, and how long after a fault's start."""
    own = record.supervision[record.supervision["controller"] == 0]
    time_s = (own["tick"] + 1) / record.frame_rate  # a verdict is available at the end of a tick
    first = {state: _first(own["state"] == state, time_s) for state in (ARMED, FALLBACK, TRIPPED)}
    tripped = own[own["state"] == TRIPPED]
    left = [t for t in (first[FALLBACK], first[TRIPPED]) if t is not None]
    after = [t - start_s for t in left if t >= start_s]
    fallen = own[own["state"] == FALLBACK]
    refused = own["refused"][own["refused"] != NO_CAUSE]
    return {
        "armed_s": first[ARMED],
        "fallback_s": first[FALLBACK],
        "tripped_s": first[TRIPPED],
        "cause": cause_name(int(tripped["cause"][0])) if len(tripped) else None,
        "fallback_cause": cause_name(int(fallen["cause"][0])) if len(fallen) else None,
        "not_armed": cause_name(int(refused[0])) if len(refused) and first[ARMED] is None else None,
        "reversals": float(own["values"][:, CODES["reversals"]].max(initial=0.0)),
        "early": any(t < start_s for t in left),
        "detected_s": min(after, default=None),
    }


def _first(which: NDArray[np.bool_], time_s: NDArray[np.float64]) -> float | None:
    at = np.flatnonzero(which)
    return float(time_s[at[0]]) if len(at) else None
