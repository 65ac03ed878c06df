"""A supervisor's tick; compiled.

First what was asked for, then the setpoints of this tick under the state that it finds, then what the frames of this
tick say, and last the monitors, whose verdict acts from the end of the tick on. While it lets a controller, or its
fallback, act, its setpoints are theirs, at their times. Otherwise it says zero (or a probe's tones) once a tick.
"""

from __future__ import annotations

import math

from facts_damping.compiling import entry_point
from facts_damping.control.inputs import UNSET, form, take
from facts_damping.elementary import log, magnitude, phase
from facts_damping.monitors import ARMED, FALLBACK
from facts_damping.signals import Deliveries, DeviceTruths, Setpoints, Supervisions
from facts_damping.supervision import monitors, probe
from facts_damping.supervision.model import Supervisors, SupervisorState, begin
from facts_damping.supervision.passing import pass_on, say, share
from facts_damping.supervision.states import conclude, judge, obey


@entry_point
def supervise(
    made: Supervisors,
    state: SupervisorState,
    s: int,
    tick: int,
    start_ns: int,
    end_ns: int,
    delivered: Deliveries,
    count: int,
    issued: Setpoints,
    many: int,
    devices: DeviceTruths,
    out: Setpoints,
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
    obey(made, state, s, start_ns)
    row.tick, row.start_ns, row.now_ns = tick, start_ns, end_ns
    first, lapses, answered = pass_on(made, state, s, tick, issued, many, out, first)
    if row.probe_ns != UNSET:  # what it says in this tick stands from its end on
        probe.expect(made, state, s, tick, state.commanded[s, row.probed].output)
    if row.state not in (ARMED, FALLBACK):
        first = say(made, state, s, tick, end_ns - 1, out, first)
    _hear(made, state, s, tick, delivered, count, answered)
    _judge(made, state, s, tick, end_ns, devices, lapses)
    return first


@entry_point
def _hear(
    made: Supervisors, state: SupervisorState, s: int, tick: int, delivered: Deliveries, count: int, answered: bool
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


@entry_point
def _judge(
    made: Supervisors, state: SupervisorState, s: int, tick: int, end_ns: int, devices: DeviceTruths, lapses: int
) -> None:
    """What the monitors say at the end of a tick, and what follows from it."""
    row = state.rows[s]
    monitors.follow(made, state, s, tick)
    if row.probe_ns != UNSET and (end_ns - row.probe_ns) * 1e-9 >= made.settings[s].probe_s:
        conclude(made, state, s, end_ns)
    monitors.data(made, state, s, end_ns)
    monitors.controller(made, state, s, end_ns, lapses)
    monitors.grid(made, state, s, devices)
    judge(made, state, s, end_ns)


@entry_point
def tell(made: Supervisors, state: SupervisorState, s: int, tick: int, out: Supervisions, at: int) -> bool:
    """What a supervisor tells of itself after a tick, into `out[at]`; False: it has failed."""
    told = out[at]
    row, own = state.rows[s], made.settings[s]
    if row.tick != tick:
        return False
    told.tick, told.controller, told.state = row.tick, own.controller, row.state
    told.cause, told.refused, told.share = row.cause, row.refused, share(row, row.now_ns)
    for m in range(row.values.size):
        told.values[m] = row.values[m]
    told.probe_gain = told.probe_phase = told.probe_coherence = math.nan
    told.added_damping = told.phase_margin = told.gain_margin = math.nan
    added, worst = 0j, -1.0
    for d in range(made.devices.shape[1]):
        found = state.commanded[s, d]
        if made.devices[s, d].place == UNSET or math.isnan(found.gain):
            continue
        apart = abs(log(max(found.gain, 1e-9))) + abs(found.phase)
        added += found.added
        if apart > worst:
            worst = apart
            told.probe_gain, told.probe_phase, told.probe_coherence = found.gain, found.phase, found.coherence
    if worst >= 0.0:
        told.added_damping = -added.real
        told.phase_margin = math.pi / 2.0 - abs(phase(-added)) if magnitude(added) > 0.0 else math.nan
        told.gain_margin = -own.sigma / added.real if added.real * own.sigma < 0.0 else math.nan
    return True
