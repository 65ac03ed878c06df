"""A supervisor's tick; compiled.

Order: commands; setpoints of this tick in the resulting state; frames of this tick; monitors, whose consequences act
from the end of the tick on. In states ARMED and FALLBACK the supervisor forwards the setpoints of the controller or the
fallback at their times of issue. In other states it sends zero, or a probe's tones, once a tick.
"""

from __future__ import annotations

import math
from typing import Any

from facts_damping.compiling import compiled, entry_point
from facts_damping.control.bank import Bank, BankState
from facts_damping.control.inputs import UNSET, compute_signals, ingest
from facts_damping.elementary import log, magnitude, phase
from facts_damping.monitor_table import ARMED, FALLBACK
from facts_damping.neurofuzzy.network import shape_of
from facts_damping.signals import Deliveries, DeviceTruths, Setpoints, Span, Supervisions
from facts_damping.supervision import monitors, probe
from facts_damping.supervision.model import SupervisorRows, Supervisors, SupervisorState, begin
from facts_damping.supervision.output import emit_zero, forward_setpoints, fraction
from facts_damping.supervision.state_machine import change_state, finish_probe, handle_commands


@entry_point
def supervise(
    supervisors: Supervisors,
    state: SupervisorState,
    s: int,
    span: Span,
    delivered: Deliveries,
    issued: Setpoints,
    devices: DeviceTruths,
    out: Setpoints,
) -> int:
    """Run a tick of supervisor s; write the acting setpoints to `out`. Returns their number.

    `delivered`: entries of its link; `issued`: setpoints, including those of its controller and fallback; `devices`:
    DEVICE_TRUTH at the start of the tick. Its row must hold the controller's health (`controller_health`). A failed
    supervisor writes nothing. A supervisor ignores scheduled commands from before it started or restarted.
    """
    tick, start_ns, end_ns = span
    row, settings = state.rows[s], supervisors.settings[s]
    if settings.dead_ns <= start_ns < settings.back_ns:
        return 0
    if settings.hung == 0 and row.start_ns < settings.dead_ns and start_ns >= settings.back_ns:
        begin(supervisors.inputs, state, s)
    if row.tick < 0 and tick > 0:
        row.start_ns = start_ns  # it started later than the run
    handle_commands(supervisors, state, s, start_ns)
    row.tick, row.start_ns, row.now_ns = tick, start_ns, end_ns
    count, lapses, answered = forward_setpoints(supervisors, state, s, tick, issued, out)
    if row.probe_ns != UNSET:
        probe.write_regressors(supervisors, state, s, tick, state.commanded[s, row.probed].output)
    if row.state not in (ARMED, FALLBACK):
        count = emit_zero(supervisors, state, s, tick, end_ns - 1, out, count)
    _process_frames(supervisors, state, s, tick, delivered, answered)
    _monitor(supervisors, state, s, tick, end_ns, devices, lapses)
    return count


@entry_point
def _process_frames(
    supervisors: Supervisors, state: SupervisorState, s: int, tick: int, delivered: Deliveries, answered: bool
) -> None:
    """Process the frames of a tick, one arrival time after another, as the controller does."""
    row, i, count = state.rows[s], 0, delivered.size
    owed = UNSET
    while i < count:
        arrival, j = delivered[i].arrival_ns, i
        while j < count and delivered[j].arrival_ns == arrival:
            monitors.check_entry(supervisors, state, s, delivered[j])
            j += 1
        i = ingest(supervisors.inputs, state.held, s, delivered, i, count)
        since = compute_signals(supervisors.inputs, state.held, s)
        if since < 0:
            continue
        monitors.update_signals(supervisors, state, s, since, arrival)
        owed = arrival if owed == UNSET else owed
        if row.probe_ns != UNSET:
            probe.update_fit(supervisors, state, s, tick)
    if answered:
        row.owed_ns = UNSET
    elif row.owed_ns == UNSET:
        row.owed_ns = owed


@entry_point
def _monitor(
    supervisors: Supervisors, state: SupervisorState, s: int, tick: int, end_ns: int, devices: DeviceTruths, lapses: int
) -> None:
    """Update the monitors at the end of a tick, and act on them."""
    row = state.rows[s]
    monitors.update_filters(supervisors, state, s, tick)
    if row.probe_ns != UNSET and (end_ns - row.probe_ns) * 1e-9 >= supervisors.settings[s].probe_s:
        finish_probe(supervisors, state, s, end_ns)
    monitors.check_data(supervisors, state, s, end_ns)
    monitors.controller(supervisors, state, s, end_ns, lapses)
    monitors.check_grid(supervisors, state, s, devices)
    change_state(supervisors, state, s, end_ns)


@entry_point
def write_status(
    supervisors: Supervisors, state: SupervisorState, s: int, tick: int, out: Supervisions, at: int
) -> bool:
    """Write a supervisor's status after a tick to `out[at]`; returns False if it has failed."""
    report = out[at]
    row, settings = state.rows[s], supervisors.settings[s]
    if row.tick != tick:
        return False
    report.tick, report.controller, report.state = row.tick, settings.controller, row.state
    report.cause, report.refused, report.fraction = row.cause, row.refused, fraction(row, row.now_ns)
    for m in range(row.values.size):
        report.values[m] = row.values[m]
    report.probe_gain = report.probe_phase = report.probe_coherence = math.nan
    report.added_damping = report.phase_margin = report.gain_margin = math.nan
    added, worst = 0j, -1.0
    for d in range(supervisors.devices.shape[1]):
        probed = state.commanded[s, d]
        if supervisors.devices[s, d].place == UNSET or math.isnan(probed.gain):
            continue
        apart = abs(log(max(probed.gain, 1e-9))) + abs(probed.phase)
        added += probed.added
        if apart > worst:
            worst = apart
            report.probe_gain, report.probe_phase, report.probe_coherence = probed.gain, probed.phase, probed.coherence
    if worst >= 0.0:
        report.added_damping = -added.real
        report.phase_margin = math.pi / 2.0 - abs(phase(-added)) if magnitude(added) > 0.0 else math.nan
        report.gain_margin = -settings.sigma / added.real if added.real * settings.sigma < 0.0 else math.nan
    return True


@compiled
def read_health(bank: Bank, state: BankState, c: int, health: Any) -> None:
    """Write the health of controller c to `health`: outputs finite, parameter norm, Lyapunov function and its fall.

    Nodes get it by messages.
    """
    health.finite = 1
    for d in range(bank.device.shape[1]):
        if bank.device[c, d] != UNSET and not math.isfinite(state.unlimited[c, d]):
            health.finite = 0
    net, total = shape_of(bank.shape[c]), 0.0
    size = net.inputs * net.rules * net.stored + net.rules * net.outputs * net.width
    groups = 1 + state.learner.group[c, size - 1] if net.rules > 0 else 0
    for g in range(groups):
        square = 0.0
        for f in range(size):
            if state.learner.group[c, f] == g:
                square += state.learner.theta[c, f] ** 2
        norm = math.sqrt(square)
        total += norm * norm
    health.norm = math.sqrt(total)
    health.lyapunov, health.fall = state.memory.lyapunov[c, 0], state.memory.lyapunov[c, 1]


@entry_point
def controller_health(bank: Bank, state: BankState, c: int, supervisor_rows: SupervisorRows, at: int) -> None:
    """Write the health of controller c into row `at` of SUPERVISOR."""
    read_health(bank, state, c, supervisor_rows[at])
