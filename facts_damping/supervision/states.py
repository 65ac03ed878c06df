"""A supervisor's states: transitions and reasons to refuse arming; compiled."""

from __future__ import annotations

import math

from facts_damping.compiling import compiled, entry_point
from facts_damping.control.inputs import UNSET
from facts_damping.monitor_table import (
    ARM,
    ARMED,
    BY_OPERATOR,
    BY_SCHEDULE,
    DISARM,
    DISARMED,
    FALL_BACK,
    FALLBACK,
    NO_CAUSE,
    NOT_IN_SHADOW,
    NOT_PROBED,
    OFF,
    PROBE,
    PROBE_GAIN,
    PROBE_HARM,
    PROBE_PHASE,
    PROBE_WEAK,
    RESET,
    SHADOW,
    TRIP,
    TRIPPED,
)
from facts_damping.supervision import monitors, probe
from facts_damping.supervision.model import Supervisors, SupervisorState


@compiled
def handle_commands(made: Supervisors, state: SupervisorState, s: int, start_ns: int) -> None:
    """Execute commands of the schedule and the operator."""
    row, own = state.rows[s], made.settings[s]
    if row.start_ns < own.probe_ns <= start_ns:
        begin_probe(made, state, s, start_ns)
    if row.start_ns < own.arm_ns <= start_ns:
        arm(made, state, s, start_ns, BY_SCHEDULE)
    asked, row.asked = row.asked, 0
    if asked == ARM:
        arm(made, state, s, start_ns, BY_OPERATOR)
    elif asked == DISARM:
        change(state, s, DISARMED, BY_OPERATOR, start_ns, own.trip_ramp)
    elif asked == RESET and (row.state in (DISARMED, TRIPPED)):
        change(state, s, SHADOW, BY_OPERATOR, start_ns, own.trip_ramp)
    elif asked == PROBE:
        begin_probe(made, state, s, start_ns)


@compiled
def change(state: SupervisorState, s: int, to: int, cause: int, at_ns: int, ramp: float) -> None:
    """Change the state; the ramp starts from the present output."""
    row = state.rows[s]
    row.state, row.cause, row.begun_ns, row.ramp, row.probe_ns = to, cause, at_ns, ramp, UNSET
    for d in range(state.commanded.shape[1]):
        state.commanded[s, d].begun = state.commanded[s, d].output


@compiled
def begin_probe(made: Supervisors, state: SupervisorState, s: int, at_ns: int) -> None:
    """Start to probe the devices one by one; refused unless in shadow with a known mode."""
    row = state.rows[s]
    if row.state != SHADOW or made.settings[s].omega <= 0.0:
        row.refused = NOT_IN_SHADOW
        return
    row.probe_ns, row.probed = at_ns, 0
    probe.reset_fit(state, s)
    for d in range(state.commanded.shape[1]):
        state.commanded[s, d].gain = math.nan


@compiled
def finish_probe(made: Supervisors, state: SupervisorState, s: int, at_ns: int) -> None:
    """Finish a device's probe, and start that of the next device."""
    row = state.rows[s]
    probe.store_result(made, state, s)
    more = row.probed < made.devices.shape[1] and made.devices[s, row.probed].place != UNSET
    row.probe_ns = at_ns if more else UNSET


@compiled
def _due(made: Supervisors, state: SupervisorState, s: int, m: int) -> bool:
    """Whether a monitor has exceeded its limit for its set duration."""
    row = state.rows[s]
    return bool(row.over_ns[m] != UNSET and row.now_ns - row.over_ns[m] >= made.thresholds[s, m].lasts_ns)


@entry_point
def refusal(made: Supervisors, state: SupervisorState, s: int) -> int:
    """Code of the monitor or other cause that forbids arming now; NO_CAUSE if arming is allowed."""
    row, own = state.rows[s], made.settings[s]
    if row.state != SHADOW or row.probe_ns != UNSET:
        return NOT_IN_SHADOW if row.state != SHADOW else NOT_PROBED
    for m in range(row.values.size):
        watched = made.thresholds[s, m]
        if watched.follows >= FALL_BACK and _due(made, state, s, m):
            return m
    added, probed = 0.0, False
    for d in range(made.devices.shape[1]):
        found = state.commanded[s, d]
        if made.devices[s, d].place == UNSET:
            continue
        if math.isnan(found.gain):
            if own.needs_probe:
                return NOT_PROBED
            continue
        if not found.coherence >= own.coherence:
            return PROBE_WEAK
        if abs(found.phase) > own.phase:
            return PROBE_PHASE
        if not 1.0 / own.gain <= found.gain <= own.gain:
            return PROBE_GAIN
        added, probed = added + found.added.real, True
    return PROBE_HARM if probed and added > 0.0 else NO_CAUSE


@compiled
def arm(made: Supervisors, state: SupervisorState, s: int, at_ns: int, by: int) -> None:
    """Arm, or store the reason of the refusal."""
    row = state.rows[s]
    row.refused = refusal(made, state, s)
    if row.refused == NO_CAUSE:
        change(state, s, ARMED, by, at_ns, made.settings[s].ramp)


@compiled
def judge(made: Supervisors, state: SupervisorState, s: int, end_ns: int) -> None:
    """Compare the monitors with their limits, and fall back, trip or recover."""
    row, own, worst, cause = state.rows[s], made.settings[s], OFF, NO_CAUSE
    for m in range(row.values.size):
        watched = made.thresholds[s, m]
        if watched.follows == OFF or not row.values[m] > watched.limit:
            row.over_ns[m] = UNSET
            continue
        if watched.follows == FALL_BACK:
            row.sound_ns = end_ns
        if row.over_ns[m] == UNSET:
            row.over_ns[m] = end_ns
        if _due(made, state, s, m) and watched.follows > worst:
            worst, cause = watched.follows, m
    waits = made.thresholds[s, monitors.LOCAL].limit
    recent = row.reserve_ns != UNSET and (end_ns - row.reserve_ns) * 1e-9 <= waits  # setpoint of a fallback
    if row.state == ARMED and worst == FALL_BACK and recent:
        change(state, s, FALLBACK, cause, end_ns, own.fall_back_ramp)
    elif (row.state == ARMED and worst >= FALL_BACK) or (row.state == FALLBACK and worst == TRIP):
        change(state, s, TRIPPED, cause, end_ns, own.trip_ramp)
    elif row.state == FALLBACK and (end_ns - max(row.sound_ns, row.begun_ns)) * 1e-9 >= own.recovery:
        change(state, s, ARMED, row.cause, end_ns, own.fall_back_ramp)
