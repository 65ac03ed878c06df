"""A supervisor's states: transitions and reasons to refuse arming; compiled."""

from __future__ import annotations

import math

from facts_damping import monitor_table as codes
from facts_damping.compiling import compiled, entry_point
from facts_damping.control.inputs import UNSET
from facts_damping.supervision import monitors, probe
from facts_damping.supervision.model import Supervisors, SupervisorState


@compiled
def handle_commands(supervisors: Supervisors, state: SupervisorState, s: int, start_ns: int) -> None:
    """Execute commands of the schedule and the operator."""
    row, settings = state.rows[s], supervisors.settings[s]
    if row.start_ns < settings.probe_ns <= start_ns:
        begin_probe(supervisors, state, s, start_ns)
    if row.start_ns < settings.arm_ns <= start_ns:
        arm(supervisors, state, s, start_ns, codes.BY_SCHEDULE)
    asked, row.asked = row.asked, 0
    if asked == codes.ARM:
        arm(supervisors, state, s, start_ns, codes.BY_OPERATOR)
    elif asked == codes.DISARM:
        change(state, s, codes.DISARMED, codes.BY_OPERATOR, start_ns, settings.trip_ramp)
    elif asked == codes.RESET and (row.state in (codes.DISARMED, codes.TRIPPED)):
        change(state, s, codes.SHADOW, codes.BY_OPERATOR, start_ns, settings.trip_ramp)
    elif asked == codes.PROBE:
        begin_probe(supervisors, state, s, start_ns)


@compiled
def change(state: SupervisorState, s: int, to: int, cause: int, at_ns: int, ramp: float) -> None:
    """Change the state; the ramp starts from the present output."""
    row = state.rows[s]
    row.state, row.cause, row.begun_ns, row.ramp, row.probe_ns = to, cause, at_ns, ramp, UNSET
    for d in range(state.commanded.shape[1]):
        state.commanded[s, d].begun = state.commanded[s, d].output


@compiled
def begin_probe(supervisors: Supervisors, state: SupervisorState, s: int, at_ns: int) -> None:
    """Start to probe the devices one by one; refused unless in shadow with a known mode."""
    row = state.rows[s]
    if row.state != codes.SHADOW or supervisors.settings[s].omega <= 0.0:
        row.refused = codes.NOT_IN_SHADOW
        return
    row.probe_ns, row.probed = at_ns, 0
    probe.reset_fit(state, s)
    for d in range(state.commanded.shape[1]):
        state.commanded[s, d].gain = math.nan


@compiled
def finish_probe(supervisors: Supervisors, state: SupervisorState, s: int, at_ns: int) -> None:
    """Finish a device's probe, and start that of the next device."""
    row = state.rows[s]
    probe.store_result(supervisors, state, s)
    more = row.probed < supervisors.devices.shape[1] and supervisors.devices[s, row.probed].place != UNSET
    row.probe_ns = at_ns if more else UNSET


@compiled
def _due(supervisors: Supervisors, state: SupervisorState, s: int, m: int) -> bool:
    """Whether a monitor has exceeded its limit for its set duration."""
    row = state.rows[s]
    return bool(row.over_ns[m] != UNSET and row.now_ns - row.over_ns[m] >= supervisors.thresholds[s, m].lasts_ns)


@entry_point
def refusal(supervisors: Supervisors, state: SupervisorState, s: int) -> int:
    """Code of the monitor or other cause that forbids arming now; NO_CAUSE if arming is allowed."""
    row, settings = state.rows[s], supervisors.settings[s]
    if row.state != codes.SHADOW or row.probe_ns != UNSET:
        return codes.NOT_IN_SHADOW if row.state != codes.SHADOW else codes.NOT_PROBED
    for m in range(row.values.size):
        watched = supervisors.thresholds[s, m]
        if watched.follows >= codes.FALL_BACK and _due(supervisors, state, s, m):
            return m
    added, probed = 0.0, False
    for d in range(supervisors.devices.shape[1]):
        probe_result = state.commanded[s, d]
        if supervisors.devices[s, d].place == UNSET:
            continue
        if math.isnan(probe_result.gain):
            if settings.needs_probe:
                return codes.NOT_PROBED
            continue
        if not probe_result.coherence >= settings.coherence:
            return codes.PROBE_WEAK
        if abs(probe_result.phase) > settings.phase:
            return codes.PROBE_PHASE
        if not 1.0 / settings.gain <= probe_result.gain <= settings.gain:
            return codes.PROBE_GAIN
        added, probed = added + probe_result.added.real, True
    return codes.PROBE_HARM if probed and added > 0.0 else codes.NO_CAUSE


@compiled
def arm(supervisors: Supervisors, state: SupervisorState, s: int, at_ns: int, by: int) -> None:
    """Arm, or store the reason of the refusal."""
    row = state.rows[s]
    row.refused = refusal(supervisors, state, s)
    if row.refused == codes.NO_CAUSE:
        change(state, s, codes.ARMED, by, at_ns, supervisors.settings[s].ramp)


@compiled
def change_state(supervisors: Supervisors, state: SupervisorState, s: int, end_ns: int) -> None:
    """Compare the monitors with their limits, and fall back, trip or recover."""
    row, settings, worst, cause = state.rows[s], supervisors.settings[s], codes.OFF, codes.NO_CAUSE
    for m in range(row.values.size):
        watched = supervisors.thresholds[s, m]
        if watched.follows == codes.OFF or not row.values[m] > watched.limit:
            row.over_ns[m] = UNSET
            continue
        if watched.follows == codes.FALL_BACK:
            row.sound_ns = end_ns
        if row.over_ns[m] == UNSET:
            row.over_ns[m] = end_ns
        if _due(supervisors, state, s, m) and watched.follows > worst:
            worst, cause = watched.follows, m
    waits = supervisors.thresholds[s, monitors.LOCAL].limit
    recent = row.reserve_ns != UNSET and (end_ns - row.reserve_ns) * 1e-9 <= waits  # setpoint of a fallback
    if row.state == codes.ARMED and worst == codes.FALL_BACK and recent:
        change(state, s, codes.FALLBACK, cause, end_ns, settings.fall_back_ramp)
    elif (row.state == codes.ARMED and worst >= codes.FALL_BACK) or (
        row.state == codes.FALLBACK and worst == codes.TRIP
    ):
        change(state, s, codes.TRIPPED, cause, end_ns, settings.trip_ramp)
    elif row.state == codes.FALLBACK and (end_ns - max(row.sound_ns, row.begun_ns)) * 1e-9 >= settings.recovery:
        change(state, s, codes.ARMED, row.cause, end_ns, settings.fall_back_ramp)
