"""Invariants that must hold for every draw of a fault campaign, and how far a record is from violating each."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import is_stable
from facts_damping.monitor_table import ARMED, FALLBACK, TRIPPED
from facts_damping.signals import NANOSECONDS, SPEED_BAND

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record

TOLERANCE = 1e-9  # p.u., for a reference at zero or at its limit
SETTLED_S = 1.0  # after the ramp of a trip: pending setpoints have arrived, and the device has followed
HARM = 1.05  # ITAE relative to no control
LOST = 10.0  # the same for a run that loses synchronism, at least
NOT_A_NUMBER = -1e6  # margin of a signal that is not a number


class Rule(NamedTuple):
    """An invariant: the unit of its margin, and the margin, the signed distance to its violation.

    The invariant holds if the margin is at least 0; infinity: nothing could violate it; None: not applicable.
    """

    unit: str
    margin: Callable[..., float | None]


def _least(*distances: NDArray[np.float64]) -> float:
    """The smallest distance of all; infinity if there is none."""
    least = min((float(np.min(some)) for some in distances if some.size), default=math.inf, key=_order)
    return NOT_A_NUMBER if math.isnan(least) else least


def _order(value: float) -> float:
    return -math.inf if math.isnan(value) else value


def limits(case: Case, record: Record, _late: int = 0) -> float:
    """Setpoints stay within the device's limit and the authority, references within limit and rate.

    Margin: smallest distance to one of these bounds, p.u. of the device's limit.
    """
    fraction, case_margins = case.supervision.authority.fraction if case.supervision else 1.0, []
    for d, name in enumerate(case.run.devices):
        device = case.system.device(name)
        passed = record.supervised["value"][record.supervised["device"] == d]
        reference = record.devices["reference"][:, d]
        steps = np.abs(np.diff(reference)) - device.rate_max * np.diff(record.time_s)
        bounds = (
            device.setpoint_max * fraction + TOLERANCE - np.abs(passed),
            device.setpoint_max + TOLERANCE - np.abs(reference),
            TOLERANCE - steps,
        )
        case_margins.append(_least(*bounds) / device.setpoint_max)
    return min(case_margins, default=math.inf)


def late_ticks(record: Record, deadline_misses: int) -> int:
    """Upper bound of the ticks by which a setpoint acted after its `effective` time, in a graph in real time.

    A tick without the link's output is a deadline miss; misses after the last delivery delay nothing.
    """
    answered = int(record.delivered["tick"].max(initial=0))
    return max(0, deadline_misses - (int(record.ticks[-1]) - answered))


def _at_zero(value: NDArray[np.float64], spare_s: NDArray[np.float64], limit: float, step_s: float) -> float:
    """Margin of a signal that must be zero after a deadline, s.

    `value`: (ticks,), p.u.; `spare_s`: (ticks,), time left to the deadline. If the signal is zero in time, the margin
    is the time that was left; else `-sum |value| / limit step_s` over the ticks after the deadline: s at the limit.
    """
    acts = np.abs(value) > TOLERANCE
    late = acts & (spare_s < 0.0)
    if late.any():
        return float(-np.sum(np.abs(value[late])) / limit * step_s)
    return _least(spare_s[acts])


def lets_go(case: Case, record: Record, late: int = 0) -> float:
    """The reference is zero within the time-out and the ramp after the last accepted setpoint; margin: `_at_zero`."""
    watchdog, case_margins = case.run.watchdog, [math.inf]
    if watchdog is None:
        return math.inf
    for d, name in enumerate(case.run.devices):
        reference, setpoint_max = record.devices["reference"][:, d], case.system.device(name).setpoint_max
        accepted = _accepted(record, d, setpoint_max, watchdog.max_age)
        if not len(accepted):
            continue
        newest = np.searchsorted(accepted, record.time_ns, side="right") - 1
        since = (record.time_ns - accepted[np.maximum(newest, 0)]) / NANOSECONDS
        allowed = watchdog.timeout + setpoint_max / watchdog.release_rate + (2.0 + late) / record.frame_rate
        asked = newest >= 0
        case_margins.append(_at_zero(reference[asked], (allowed - since)[asked], setpoint_max, 1.0 / record.frame_rate))
    return min(case_margins)


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


def zero_after_trip(case: Case, record: Record, _late: int = 0) -> float:
    """After a trip and its ramp, the supervisor sends zero until the end of the run, even after a restart.

    Margin: time from its last setpoint that is not zero, or from its last other state, to the deadline, s.
    """
    status, passed, case_margins = record.supervision, record.supervised, [math.inf]
    for c, tick in _first_trips(record).items():
        after = (tick / record.frame_rate + _trip_ramp_s(case)) * NANOSECONDS + 2 * NANOSECONDS / record.frame_rate
        acts = passed["issued_ns"][(passed["controller"] == c) & (passed["value"] != 0.0)]
        later = status[(status["controller"] == c) & (status["tick"] >= tick)]
        back = later["tick"][np.isin(later["state"], (ARMED, FALLBACK))]
        case_margins.append(_least((after - acts) / NANOSECONDS, (tick - 1.0 - back) / record.frame_rate))
    return min(case_margins)


def device_at_zero(case: Case, record: Record, late: int = 0) -> float:
    """After a trip, and after pending setpoints have arrived, the device's reference is zero; margin: `_at_zero`."""
    case_margins = [math.inf]
    for c, tick in _first_trips(record).items():
        spare = (tick + late) / record.frame_rate + _trip_ramp_s(case) + SETTLED_S - record.time_s
        for name in case.controllers[c].devices:
            reference, limit = record.devices["reference"], case.system.device(name).setpoint_max
            device_reference = reference[:, case.run.devices.index(name)]
            case_margins.append(_at_zero(device_reference, spare, limit, 1.0 / record.frame_rate))
    return min(case_margins)


def causes(_case: Case, record: Record, _late: int = 0) -> float:
    """Every trip has a recorded cause; margin: less the time without one, s."""
    tripped = record.supervision["state"] == TRIPPED
    return -int(np.sum(record.supervision["cause"][tripped] < 0)) / record.frame_rate


def synchronism(record: Record, uncontrolled: Record) -> float | None:
    """Synchronism is kept if it is kept without control (else None).

    Margin: `1 - (largest rotor angle difference) / 180 deg`; if synchronism is lost, less the fraction of the run after
    the loss. The run ends there, so that only a robustness in time exists (A. Donze, O. Maler, FORMATS 2010).
    """
    if lost_s(uncontrolled) is not None:
        return None
    lost = lost_s(record)
    if lost is not None:
        end = float(uncontrolled.time_s[-1]) + 1.0 / uncontrolled.frame_rate
        return min(lost / end - 1.0, -TOLERANCE)
    angles = record.machines["rotor_angle"]
    if angles.shape[1] <= 1:  # against an infinite bus
        angles = np.hstack([angles, np.zeros((len(angles), 1))])
    return max(0.0, 1.0 - float(np.nanmax(np.ptp(angles, axis=1), initial=0.0)) / math.pi)


def harm(record: Record, uncontrolled: Record) -> float | None:
    """ITAE is at most `HARM` times that without control; None if that loses synchronism.

    Margin: `HARM - ITAE / (ITAE without control)`. After a loss of synchronism every speed difference counts as
    `SPEED_BAND`, beyond which the model of a machine is not valid; the ratio is then `LOST` at least.
    """
    index, none = itae(record), itae(uncontrolled)
    if none is None:
        return None
    scale = max(none, float(np.finfo(float).tiny))
    if index is not None:
        return (HARM * none - index) / scale
    return HARM - float(np.fmax(LOST, _beyond(record, float(uncontrolled.time_s[-1])) / scale))


def _beyond(record: Record, end_s: float) -> float:
    """ITAE of a run that ended early, to an end (s)."""
    t, x = record.time_s, columns(speed_differences(record))
    after = x.shape[1] * SPEED_BAND * max(0.0, end_s**2 - float(t[-1]) ** 2) / 2.0
    return float(performance_indices(t, x)["ITAE"] + after)


# Invariants of a single record, by column of the table: margin(case, record, late).
ALONE = {
    "within_limits": Rule("p.u. of the limit", limits),
    "lets_go": Rule("s", lets_go),
    "zero_after_trip": Rule("s", zero_after_trip),
    "device_at_zero": Rule("s", device_at_zero),
    "cause_recorded": Rule("s", causes),
}
# Relative to a run without control: margin(record, uncontrolled).
BESIDE = {"keeps_synchronism": Rule("fraction", synchronism), "does_no_harm": Rule("ITAE ratio", harm)}
INVARIANTS = (*ALONE, *BESIDE)


def margins(case: Case, record: Record, uncontrolled: Record, late: int = 0) -> dict[str, float | None]:
    """Margins of all invariants by column; `late`: ticks by which setpoints may have acted too late."""
    alone_margins = {name: rule.margin(case, record, late) for name, rule in ALONE.items()}
    return alone_margins | {name: rule.margin(record, uncontrolled) for name, rule in BESIDE.items()}


def alone(case: Case, record: Record, late: int = 0) -> dict[str, bool]:
    """Whether the invariants of a single record hold, by column; `late` as in `margins`."""
    return {name: bool(holds(rule.margin(case, record, late))) for name, rule in ALONE.items()}


def holds(margin: float | None) -> bool | None:
    """Whether an invariant with this margin holds; None: not applicable."""
    return None if margin is None else margin >= 0.0


def itae(record: Record) -> float | None:
    """ITAE of a run, p.u. s^2; None if it loses synchronism."""
    if is_stable(record) is not True:
        return None
    return performance_indices(record.time_s, columns(speed_differences(record)))["ITAE"]


def lost_s(record: Record) -> float | None:
    """Time of the loss of synchronism, s; or None."""
    lost = np.flatnonzero(~record.in_synchronism)
    return float(record.time_s[lost[0]]) if len(lost) else None


class EffectAlone(NamedTuple):
    """Figures of a run relative to the same without control, which is known; fields as in `Effect`."""

    lost_s: float | None
    ITAE: float | None
    ratio: float | None
    keeps_synchronism: bool | None
    does_no_harm: bool | None


class Effect(NamedTuple):
    """Figures of a run relative to the same without control, and of that; None where synchronism is lost."""

    lost_s: float | None = None  # when synchronism is lost; None: it is kept
    uncontrolled_lost_s: float | None = None
    ITAE: float | None = None  # p.u. s^2
    uncontrolled_ITAE: float | None = None
    ratio: float | None = None  # of the two
    keeps_synchronism: bool | None = None  # rules of BESIDE; None: not applicable
    does_no_harm: bool | None = None

    @property
    def invariants(self) -> dict[str, bool | None]:
        """Whether the rules of BESIDE hold."""
        return {name: getattr(self, name) for name in BESIDE}

    @property
    def controlled(self) -> EffectAlone:
        """Without the figures of the run without control."""
        return EffectAlone(self.lost_s, self.ITAE, self.ratio, self.keeps_synchronism, self.does_no_harm)


def beside(record: Record, uncontrolled: Record) -> Effect:
    """Figures of a run relative to the same without control.

    If that one falls out of step, control cannot make it worse: both conditions are None. If it does not, a run that
    falls out of step violates both. A ratio exists if neither does.
    """
    index, none = itae(record), itae(uncontrolled)
    rules = {name: holds(rule.margin(record, uncontrolled)) for name, rule in BESIDE.items()}
    ratio = index / none if index is not None and none else None
    return Effect(lost_s(record), lost_s(uncontrolled), index, none, ratio, **rules)
