"""A supervisor's output: the acting source's setpoints, limited to its authority, or zero; compiled.

After a change of source, the output is v = (1 - b) v_0 + b u: v_0 is the last output before the change, u the new
source's setpoint (0 for NOBODY), and b rises from 0 to 1 during the ramp.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.control.inputs import UNSET
from facts_damping.monitor_table import ARMED, FALLBACK
from facts_damping.supervision import probe
from facts_damping.supervision.model import CONTROLLER, NOBODY, RESERVE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.supervision.model import Supervisors, SupervisorState


MINUTE = 60.0  # s


@compiled
def source_of(state: int) -> int:
    """Source of the setpoints that act in a state."""
    return CONTROLLER if state == ARMED else RESERVE if state == FALLBACK else NOBODY


@compiled
def forward_setpoints(
    supervisors: Supervisors, state: SupervisorState, s: int, tick: int, issued: NDArray[Any], out: NDArray[Any]
) -> tuple[int, int, bool]:
    """Store the setpoints of controller and fallback in order of time; write the acting source's to `out`.

    Returns the number of setpoints written, the number of non-finite ones, and whether the controller issued any.
    """
    row, settings, many = state.rows[s], supervisors.settings[s], issued.size
    count, lapses, answered, acts = 0, 0, False, source_of(row.state)
    a, b = _next(issued, 0, settings.controller), _next(issued, 0, settings.reserve)
    while a < many or b < many:
        of_controller = b >= many or (a < many and issued[a].issued_ns <= issued[b].issued_ns)
        i, source = (a, CONTROLLER) if of_controller else (b, RESERVE)
        setpoint = issued[i]
        if of_controller:
            answered, a = True, _next(issued, a + 1, settings.controller)
        else:
            row.reserve_ns, b = setpoint.issued_ns, _next(issued, b + 1, settings.reserve)
        d = _place(supervisors, s, setpoint.device)
        if d == UNSET:
            continue
        if math.isfinite(setpoint.value):
            state.commanded[s, d].given[source] = setpoint.value
        elif of_controller or source == acts:
            lapses += 1
        if source == acts:
            _write(supervisors, state, s, d, tick, setpoint.issued_ns, setpoint.measured_ns, out[count])
            count += 1
    return count, lapses, answered


@compiled
def _next(issued: NDArray[Any], i: int, controller: int) -> int:
    """Index of a controller's next setpoint from index i on; that after the last if there is none."""
    while i < issued.size and issued[i].controller != controller:
        i += 1
    return i


@compiled
def _place(supervisors: Supervisors, s: int, device: int) -> int:
    """Index of an installed device among a supervisor's devices; UNSET if it has none."""
    for d in range(supervisors.devices.shape[1]):
        if supervisors.devices[s, d].place == device:
            return d
    return UNSET


@compiled
def emit_zero(
    supervisors: Supervisors, state: SupervisorState, s: int, tick: int, at_ns: int, out: NDArray[Any], first: int
) -> int:
    """Write setpoints of zero, of the rest of a ramp, or of a probe. Returns the index after the last.

    They use no measurement: their time of measurement is that of issue.
    """
    for d in range(supervisors.devices.shape[1]):
        if supervisors.devices[s, d].place != UNSET:
            state.commanded[s, d].given[NOBODY] = probe.tones(supervisors, state, s, d, at_ns)
            _write(supervisors, state, s, d, tick, at_ns, at_ns, out[first])
            first += 1
    return first


@compiled
def _write(
    supervisors: Supervisors,
    state: SupervisorState,
    s: int,
    d: int,
    tick: int,
    at_ns: int,
    measured_ns: int,
    setpoint: Any,
) -> None:
    """Write a device's setpoint at a time: the acting source's, ramped, limited in size, energy and rate."""
    row, settings = state.rows[s], supervisors.settings[s]
    device, b, limit = state.commanded[s, d], fraction(row, at_ns), supervisors.devices[s, d].limit
    v, before = min(max(device.given[source_of(row.state)], -limit), limit), device.output
    if b < 1.0:
        v = (1.0 - b) * device.begun + b * v
    since = (at_ns - row.issued_ns) * 1e-9
    if d == 0 or since > 0.0:
        _spend(supervisors, state, s, since)
        row.issued_ns = at_ns
        row.since = since
    if row.spent >= settings.energy:
        limit *= math.sqrt(settings.energy / MINUTE / _commanded(supervisors, s))
    v = min(max(v, -limit), limit)
    if math.isfinite(settings.rate):
        reach = settings.rate * row.since
        v = min(max(v, before - reach), before + reach)
    device.output = v
    setpoint.tick, setpoint.controller, setpoint.device = tick, settings.controller, supervisors.devices[s, d].place
    setpoint.measured_ns, setpoint.issued_ns, setpoint.effective_ns, setpoint.value = measured_ns, at_ns, at_ns, v


@compiled
def _spend(supervisors: Supervisors, state: SupervisorState, s: int, since: float) -> None:
    """Add the energy used in `since` seconds, and regain it at a rate of `energy` a minute."""
    row, settings = state.rows[s], supervisors.settings[s]
    if math.isfinite(settings.energy):
        used = 0.0
        for d in range(supervisors.devices.shape[1]):
            if supervisors.devices[s, d].place != UNSET:
                used += (state.commanded[s, d].output / supervisors.devices[s, d].limit) ** 2
        row.spent = max(0.0, row.spent + (used - settings.energy / MINUTE) * since)


@compiled
def _commanded(supervisors: Supervisors, s: int) -> int:
    count = 0
    for d in range(supervisors.devices.shape[1]):
        count += supervisors.devices[s, d].place != UNSET
    return count


@compiled
def fraction(row: Any, at_ns: int) -> float:
    """Completed fraction of the ramp since the newest change of state, 0 to 1."""
    since = (at_ns - row.begun_ns) * 1e-9
    return 1.0 if since >= row.ramp else max(0.0, since / row.ramp)
