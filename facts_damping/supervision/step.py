"""A supervisor's tick; compiled.

First what was asked for, then the setpoints of this tick under the state that it finds, then what the frames of this
tick say, and last the monitors, whose verdict acts from the end of the tick on. While it lets a controller, or its
fallback, act, its setpoints are theirs, at their times. Otherwise it says zero (or a probe's tones) once a tick.

Whoever takes over from whom: v = (1 - b) v_0 + b u, v_0 what was said last before the change, u the newcomer's setpoint
(0: nobody's), b from 0 to 1 in the time of a ramp.
"""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled, inner
from facts_damping.control.inputs import UNSET, form, take
from facts_damping.monitors import (
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
from facts_damping.supervision.model import CONTROLLER, NOBODY, RESERVE, begin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.supervision.model import Supervisors, SupervisorState

MINUTE = 60.0  # s


@compiled
def supervise(
    made: Supervisors,
    state: SupervisorState,
    s: int,
    tick: int,
    start_ns: int,
    end_ns: int,
    delivered: NDArray[Any],
    count: int,
    issued: NDArray[Any],
    many: int,
    devices: NDArray[Any],
    out: NDArray[Any],
    first: int,
) -> int:
    """A tick of supervisor s: setpoints that act into `out` from index `first` on; the index after the last.

    `delivered`: the `count` entries of its link; `issued`: `many` setpoints, its controller's and its fallback's among
    them; `devices`: DEVICE_TRUTH at the start of the tick. What it is to know of its controller's inner life stands in
    its row (`inner_life.py`). A supervisor that has failed says nothing; what the schedule asked for before it began,
    or began again, it does not know.
    """
    row, own = state.rows[s], made.settings[s]
    if own.dead_ns <= start_ns < own.back_ns:
        return first
    if own.hung == 0 and row.start_ns < own.dead_ns and start_ns >= own.back_ns:
        begin(state, s)
    if row.tick < 0 and tick > 0:
        row.start_ns = start_ns  # it began later than the run
    _obey(made, state, s, start_ns)
    row.tick, row.start_ns, row.now_ns = tick, start_ns, end_ns
    first, lapses, answered = _pass_on(made, state, s, tick, issued, many, out, first)
    if row.probe_ns != UNSET:  # what it says in this tick stands from its end on
        probe.expect(made, state, s, tick, state.commanded[s, row.probed].output)
    if row.state not in (ARMED, FALLBACK):
        first = _say(made, state, s, tick, end_ns - 1, out, first)
    _hear(made, state, s, tick, delivered, count, answered)
    monitors.follow(made, state, s, tick)
    if row.probe_ns != UNSET and (end_ns - row.probe_ns) * 1e-9 >= own.probe_s:
        _conclude(made, state, s, end_ns)
    monitors.data(made, state, s, end_ns)
    monitors.controller(made, state, s, end_ns, lapses)
    monitors.grid(made, state, s, devices)
    _judge(made, state, s, end_ns)
    return first


@inner
def _obey(made: Supervisors, state: SupervisorState, s: int, start_ns: int) -> None:
    """What the schedule or an operator asks for."""
    row, own = state.rows[s], made.settings[s]
    if row.start_ns < own.probe_ns <= start_ns:
        _begin_probe(made, state, s, start_ns)
    if row.start_ns < own.arm_ns <= start_ns:
        _arm(made, state, s, start_ns, BY_SCHEDULE)
    asked, row.asked = row.asked, 0
    if asked == ARM:
        _arm(made, state, s, start_ns, BY_OPERATOR)
    elif asked == DISARM:
        _change(state, s, DISARMED, BY_OPERATOR, start_ns, own.trip_ramp)
    elif asked == RESET and (row.state in (DISARMED, TRIPPED)):
        _change(state, s, SHADOW, BY_OPERATOR, start_ns, own.trip_ramp)
    elif asked == PROBE:
        _begin_probe(made, state, s, start_ns)


@inner
def _change(state: SupervisorState, s: int, to: int, cause: int, at_ns: int, ramp: float) -> None:
    """Go to another state: what was said last is where the ramp begins."""
    row = state.rows[s]
    row.state, row.cause, row.begun_ns, row.ramp, row.probe_ns = to, cause, at_ns, ramp, UNSET
    for d in range(state.commanded.shape[1]):
        state.commanded[s, d].begun = state.commanded[s, d].output


@inner
def _begin_probe(made: Supervisors, state: SupervisorState, s: int, at_ns: int) -> None:
    """Probe the devices, one after the other, if it is in shadow and knows the mode."""
    row = state.rows[s]
    if row.state != SHADOW or made.settings[s].omega <= 0.0:
        row.refused = NOT_IN_SHADOW
        return
    row.probe_ns, row.probed = at_ns, 0
    probe.forget(state, s)
    for d in range(state.commanded.shape[1]):
        state.commanded[s, d].gain = math.nan


@inner
def _conclude(made: Supervisors, state: SupervisorState, s: int, at_ns: int) -> None:
    """The end of a device's probe; then the next one's."""
    row = state.rows[s]
    probe.conclude(made, state, s)
    more = row.probed < made.devices.shape[1] and made.devices[s, row.probed].place != UNSET
    row.probe_ns = at_ns if more else UNSET


@compiled
def refusal(made: Supervisors, state: SupervisorState, s: int) -> int:
    """Why a supervisor cannot be armed now: a monitor's code, or another cause; NO_CAUSE: it can."""
    row, own = state.rows[s], made.settings[s]
    if row.state != SHADOW or row.probe_ns != UNSET:
        return NOT_IN_SHADOW if row.state != SHADOW else NOT_PROBED
    for m in range(row.values.size):
        watched = made.thresholds[s, m]
        if watched.follows >= FALL_BACK and row.values[m] > watched.limit:
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


@inner
def _arm(made: Supervisors, state: SupervisorState, s: int, at_ns: int, by: int) -> None:
    """Let the controller act, or say why not."""
    row = state.rows[s]
    row.refused = refusal(made, state, s)
    if row.refused == NO_CAUSE:
        _change(state, s, ARMED, by, at_ns, made.settings[s].ramp)


@inner
def _source(state: int) -> int:
    """Whose setpoints act in a state."""
    return CONTROLLER if state == ARMED else RESERVE if state == FALLBACK else NOBODY


@inner
def _pass_on(
    made: Supervisors,
    state: SupervisorState,
    s: int,
    tick: int,
    issued: NDArray[Any],
    many: int,
    out: NDArray[Any],
    first: int,
) -> tuple[int, int, bool]:
    """Take the setpoints of controller and fallback, by time; whoever acts has them passed on.

    Index after the last that is said; how many were not finite; whether the controller has said something.
    """
    row, own = state.rows[s], made.settings[s]
    lapses, answered, acts = 0, False, _source(row.state)
    a, b = _next(issued, many, 0, own.controller), _next(issued, many, 0, own.reserve)
    while a < many or b < many:
        of_controller = b >= many or (a < many and issued[a].issued_ns <= issued[b].issued_ns)
        i, source = (a, CONTROLLER) if of_controller else (b, RESERVE)
        given = issued[i]
        if of_controller:
            answered, a = True, _next(issued, many, a + 1, own.controller)
        else:
            row.reserve_ns, b = given.issued_ns, _next(issued, many, b + 1, own.reserve)
        d = _place(made, s, given.device)
        if d == UNSET:
            continue
        if math.isfinite(given.value):
            state.commanded[s, d].given[source] = given.value
        elif of_controller or source == acts:
            lapses += 1
        if source == acts:
            _write(made, state, s, d, tick, given.issued_ns, given.measured_ns, out, first)
            first += 1
    return first, lapses, answered


@inner
def _next(issued: NDArray[Any], many: int, i: int, controller: int) -> int:
    """Index from i on of the next setpoint of a controller."""
    while i < many and issued[i].controller != controller:
        i += 1
    return i


@inner
def _place(made: Supervisors, s: int, device: int) -> int:
    """Place of a device among a supervisor's."""
    for d in range(made.devices.shape[1]):
        if made.devices[s, d].place == device:
            return d
    return UNSET


@inner
def _say(
    made: Supervisors, state: SupervisorState, s: int, tick: int, at_ns: int, out: NDArray[Any], first: int
) -> int:
    """Zero, or what is left of a ramp, or a probe's tones; they rest on no measurement but that of the time."""
    for d in range(made.devices.shape[1]):
        if made.devices[s, d].place != UNSET:
            state.commanded[s, d].given[NOBODY] = probe.tones(made, state, s, d, at_ns)
            _write(made, state, s, d, tick, at_ns, at_ns, out, first)
            first += 1
    return first


@inner
def _write(
    made: Supervisors,
    state: SupervisorState,
    s: int,
    d: int,
    tick: int,
    at_ns: int,
    measured_ns: int,
    out: NDArray[Any],
    first: int,
) -> None:
    """A device's setpoint at a time: of who acts, within the authority, of which a ramp has its share."""
    row, own = state.rows[s], made.settings[s]
    device, b, limit = state.commanded[s, d], share(row, at_ns), made.devices[s, d].limit
    v, before = min(max(device.given[_source(row.state)], -limit), limit), device.output
    if b < 1.0:
        v = (1.0 - b) * device.begun + b * v
    since = (at_ns - row.issued_ns) * 1e-9
    if d == 0 or since > 0.0:
        _spend(made, state, s, since)
        row.issued_ns = at_ns
        row.since = since
    if row.spent >= own.energy:
        limit *= math.sqrt(own.energy / MINUTE / _commanded(made, s))
    v = min(max(v, -limit), limit)
    if math.isfinite(own.rate):
        reach = own.rate * row.since
        v = min(max(v, before - reach), before + reach)
    device.output = v
    said = out[first]
    said.tick, said.controller, said.device = tick, own.controller, made.devices[s, d].place
    said.measured_ns, said.issued_ns, said.effective_ns, said.value = measured_ns, at_ns, at_ns, v


@inner
def _spend(made: Supervisors, state: SupervisorState, s: int, since: float) -> None:
    """Full output, squared, that was used; what may be used in a minute comes back."""
    row, own = state.rows[s], made.settings[s]
    if math.isfinite(own.energy):
        used = 0.0
        for d in range(made.devices.shape[1]):
            if made.devices[s, d].place != UNSET:
                used += (state.commanded[s, d].output / made.devices[s, d].limit) ** 2
        row.spent = max(0.0, row.spent + (used - own.energy / MINUTE) * since)


@inner
def _commanded(made: Supervisors, s: int) -> int:
    """How many devices a supervisor commands."""
    found = 0
    for d in range(made.devices.shape[1]):
        found += made.devices[s, d].place != UNSET
    return found


@inner
def share(row: Any, at_ns: int) -> float:
    """How far the newest change of whose setpoints act has come, 0 to 1."""
    since = (at_ns - row.begun_ns) * 1e-9
    return 1.0 if since >= row.ramp else max(0.0, since / row.ramp)


@inner
def _hear(
    made: Supervisors, state: SupervisorState, s: int, tick: int, delivered: NDArray[Any], count: int, answered: bool
) -> None:
    """Take the frames of a tick, arrival by arrival, as the controller does."""
    row, i = state.rows[s], 0
    owed = UNSET
    while i < count:
        arrival, j = delivered[i].arrival_ns, i
        while j < count and delivered[j].arrival_ns == arrival:
            monitors.look(made, state, s, delivered[j])
            j += 1
        i = take(state.held, s, delivered, i, count)
        since = form(made.inputs, state.held, s)
        if since < 0:
            continue
        monitors.sense(made, state, s, since, arrival)
        owed = arrival if owed == UNSET else owed
        if row.probe_ns != UNSET:
            probe.hear(made, state, s, tick)
    if answered:
        row.owed_ns = UNSET
    elif row.owed_ns == UNSET:
        row.owed_ns = owed


@inner
def _judge(made: Supervisors, state: SupervisorState, s: int, end_ns: int) -> None:
    """What follows from the monitors' values."""
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
        if end_ns - row.over_ns[m] >= watched.lasts_ns and watched.follows > worst:
            worst, cause = watched.follows, m
    if row.state == ARMED and worst == FALL_BACK and _reserve_is_there(made, state, s, end_ns):
        _change(state, s, FALLBACK, cause, end_ns, own.fall_back_ramp)
    elif (row.state == ARMED and worst >= FALL_BACK) or (row.state == FALLBACK and worst == TRIP):
        _change(state, s, TRIPPED, cause, end_ns, own.trip_ramp)
    elif row.state == FALLBACK and (end_ns - max(row.sound_ns, row.begun_ns)) * 1e-9 >= own.recovery:
        _change(state, s, ARMED, row.cause, end_ns, own.fall_back_ramp)


@inner
def _reserve_is_there(made: Supervisors, state: SupervisorState, s: int, end_ns: int) -> bool:
    """Whether there is a fallback that has said something lately."""
    row = state.rows[s]
    waits = made.thresholds[s, monitors.LOCAL].limit
    return bool(row.reserve_ns != UNSET and (end_ns - row.reserve_ns) * 1e-9 <= waits)


@compiled
def tell(made: Supervisors, state: SupervisorState, s: int, tick: int, told: Any) -> bool:
    """What a supervisor tells of itself after a tick, into a record of SUPERVISION; False: it has failed."""
    row, own = state.rows[s], made.settings[s]
    if row.tick != tick:
        return False
    told.tick, told.controller, told.state = row.tick, own.controller, row.state
    told.cause, told.refused, told.share = row.cause, row.refused, share(row, row.now_ns)
    for m in range(row.values.size):
        told.values[m] = row.values[m]
    told.probe_gain = told.probe_phase = told.probe_coherence = math.nan
    told.added_damping = told.phase_margin = math.nan
    added, worst = 0j, -1.0
    for d in range(made.devices.shape[1]):
        found = state.commanded[s, d]
        if made.devices[s, d].place == UNSET or math.isnan(found.gain):
            continue
        apart = abs(math.log(max(found.gain, 1e-9))) + abs(found.phase)
        added += found.added
        if apart > worst:
            worst = apart
            told.probe_gain, told.probe_phase, told.probe_coherence = found.gain, found.phase, found.coherence
    if worst >= 0.0:
        told.added_damping = -added.real
        told.phase_margin = math.pi / 2.0 - abs(cmath.phase(-added)) if abs(added) > 0.0 else math.nan
    return True
