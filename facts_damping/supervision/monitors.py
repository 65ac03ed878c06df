"""Values of a supervisor's monitors after a tick; compiled. `facts_damping/monitor_table.py` defines the monitors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled
from facts_damping.control.compensation import phasor
from facts_damping.control.inputs import TURN, UNSET
from facts_damping.elementary import exp, log, magnitude
from facts_damping.monitor_table import ARMED, BAD, FALL_BACK, FALLBACK
from facts_damping.signals import CHANNELS
from facts_damping.supervision.model import CONTROLLER, CYCLES_KEPT
from facts_damping.supervision.probe import gain_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1, Float2
    from facts_damping.supervision.model import Supervisors, SupervisorState

(MISSING, STALE, JITTER, MISALIGNED, STUCK, RANGE, ANGLE, SPEED, POWERS, STATUS, CLOCK, LOCAL) = range(12)
(SILENT, NON_FINITE, SATURATED, REVERSALS, WEIGHTS, LYAPUNOV) = range(12, 18)
(HARM, GROWING, FREQUENCY, ISLANDING, DEVICE, FORCED) = range(18, 24)
LAST_OF_DATA = LOCAL

_CHANNEL = {name: i for i, name in enumerate(CHANNELS)}
_ANGLE, _SPEED, _POWER = _CHANNEL["voltage_angle"], _CHANNEL["speed_deviation"], _CHANNEL["active_power"]
_FREQUENCY = _CHANNEL["frequency"]

SMOOTHING = 0.1  # s, time constant of a PMU's mismatches
LATENCY = 1.0  # s, time constant of the mean latency
SATURATION = 2.0  # s, window
REVERSAL = 0.1  # fraction of the limit: least swing back that counts as a reversal
ACTS = 0.05  # fraction of the limit: least output that affects the grid
WORKS = 0.5  # fraction of the limit: least output, in a cycle, of a controller that may drive an oscillation
SWINGS = 0.15  # fraction of the limit: least slow part of that output
SLOW = 2.0  # rate of the two sections that leave the slow part / omega of the mode
MORE = 1.6  # least size of a driven oscillation / that of earlier swings as they would be by now without control
SLACK = 0.05  # 1/s, by which the growth of a single cycle may be less than without control
FORGET = 0.2  # 1/s, least rate at which earlier swings are forgotten
MEMORIES = 4.0  # 1/|sigma|: least time to tell a wave from a mode in noise,
SHORTEST, LONGEST = 20.0, 100.0  # cycles, within these bounds
ANEW = 20.0  # square of the signal / its mean: an event has begun a new oscillation
ANSWERS = 0.01  # fraction of the limit: least amplitude of an output that answers an oscillation
MIN_POWER = 0.1  # p.u., least base for comparing powers
MIN_LYAPUNOV = 1e-3  # least base for its relative rise: an error of 1/20 of `scale`
PHASOR = 0.25  # rate of the phasor filters / omega of the mode


@compiled
def check_entry(supervisors: Supervisors, state: SupervisorState, s: int, entry: Any) -> None:
    """Update a PMU's data quality from a newer frame; call it for each frame of an arrival, before `ingest`."""
    pmu = state.pmus[s, entry.pmu]
    before_ns = pmu.measured_ns
    if entry.measured_ns <= before_ns:
        return
    pmu.measured_ns = entry.measured_ns
    values = entry.values
    pmu.early = (entry.measured_ns - entry.arrival_ns) * 1e-9
    off = values[_FREQUENCY] - supervisors.settings[s].nominal
    if before_ns == UNSET or math.isnan(pmu.angle):
        pmu.angle = pmu.angle_at_start = values[_ANGLE]
        return
    dt = (entry.measured_ns - before_ns) * 1e-9
    fraction = 1.0 - exp(-dt / SMOOTHING)
    if math.isfinite(off) and math.isfinite(values[_ANGLE]):
        turn = values[_ANGLE] - pmu.angle - TURN * off * dt
        turn -= TURN * math.floor(turn / TURN + 0.5)
        pmu.turning += fraction * (-turn / (TURN * dt) - pmu.turning)
        pmu.angle += turn + TURN * off * dt
    slip = values[_SPEED] * supervisors.settings[s].nominal - off
    if math.isfinite(slip):
        pmu.slipping += fraction * (slip - pmu.slipping)


@compiled
def update_signals(supervisors: Supervisors, state: SupervisorState, s: int, since_ns: int, arrival_ns: int) -> None:
    """Update latency, jitter and the signal's phasor from new signals."""
    row, dt = state.rows[s], since_ns * 1e-9
    latency = (arrival_ns - state.held.newest_ns[s]) * 1e-9
    if row.arrived_ns == UNSET:
        row.latency = latency
    fraction = 1.0 - exp(-dt / LATENCY)
    row.latency += fraction * (latency - row.latency)
    row.jitter += fraction * (abs(latency - row.latency) - row.jitter)
    row.arrived_ns = arrival_ns
    omega = supervisors.settings[s].omega
    if omega > 0.0:
        phasor(omega, 0.0, PHASOR * omega, state.phasors[s, 0], state.held.signal[s, 0], dt)


@compiled
def update_filters(supervisors: Supervisors, state: SupervisorState, s: int, tick: int) -> None:
    """Store a tick's signal and outputs, and update the outputs' phasors.

    The outputs are those that act; if none acts, the controller's setpoints, limited to the authority.
    """
    row, settings, size = state.rows[s], supervisors.settings[s], state.past.shape[1]
    place, y = state.past[s, tick % size], state.held.signal[s, 0]
    gain = 1.0 - exp(-SLOW * settings.omega / settings.frame_rate)
    place[0] = _slow(row.slow, gain, y if math.isfinite(y) else row.slow[0])
    place[1] = place[2] = place[3] = place[4] = row.effort = 0.0
    for d in range(supervisors.devices.shape[1]):
        device, limit = state.commanded[s, d], supervisors.devices[s, d].limit
        if supervisors.devices[s, d].place == UNSET:
            continue
        acting = row.state in (ARMED, FALLBACK)
        u = device.output if acting else min(max(device.given[CONTROLLER], -limit), limit)
        slow = _slow(device.slow, gain, u if acting else 0.0)
        row.effort = max(row.effort, abs(u) / limit)
        if acting:
            place[1], place[4] = max(place[1], abs(u) / limit), max(place[4], abs(slow) / limit)
        if abs(u) >= limit:
            place[2] = math.copysign(1.0, u)
        place[3] += _turn(device, u, REVERSAL * limit)
        if settings.omega > 0.0:
            phasor(settings.omega, 0.0, PHASOR * settings.omega, state.phasors[s, 1 + d], u, 1.0 / settings.frame_rate)


@compiled
def _slow(sections: Float1, gain: float, x: float) -> float:
    """A step of two first-order sections in a row: what is left of fast noise and of fast cycles is small."""
    sections[0] += gain * (x - sections[0])
    sections[1] += gain * (sections[0] - sections[1])
    return sections[1]  # type: ignore[no-any-return]


@compiled
def _turn(device: Any, u: float, minimum: float) -> float:
    """1 if an output has reversed by more than `minimum` from its newest extreme, else 0."""
    moved, before = u - device.extreme, device.direction
    if before * moved > 0.0:
        device.extreme = u
    elif abs(moved) > minimum:
        device.extreme, device.direction = u, math.copysign(1.0, moved)
        return 1.0 if before != 0.0 else 0.0
    return 0.0


@compiled
def check_data(supervisors: Supervisors, state: SupervisorState, s: int, end_ns: int) -> None:
    """Update the monitors of data."""
    row, settings, held = state.rows[s], supervisors.settings[s], state.held
    value = row.values
    value[MISSING] = (end_ns - max(row.arrived_ns, 0)) * 1e-9
    value[JITTER] = row.jitter
    oldest = newest = UNSET
    for name in range(STUCK, CLOCK + 1):
        value[name] = 0.0
    for i in range(held.entry_ns.shape[1]):
        at = held.entry_ns[s, i]
        if not held.uses[s, i] or at == UNSET:
            continue
        pmu = state.pmus[s, i]
        oldest, newest = at if oldest == UNSET else min(oldest, at), max(newest, at)
        value[STUCK] = max(value[STUCK], (at - held.same_ns[s, i]) * 1e-9)
        value[ANGLE] = max(value[ANGLE], abs(pmu.turning))
        value[SPEED] = max(value[SPEED], abs(pmu.slipping))
        value[STATUS] += 1.0 if held.status[s, i] & BAD else 0.0
        value[CLOCK] = max(value[CLOCK], pmu.early)
        for c in range(supervisors.plausible.size):
            if supervisors.used[s, c]:
                size = held.entry[s, i, c] - (settings.nominal if c == _FREQUENCY else 0.0)
                value[RANGE] = max(value[RANGE], abs(size) / supervisors.plausible[c])
    value[STALE] = 0.0 if oldest == UNSET else (end_ns - oldest) * 1e-9
    value[MISALIGNED] = (newest - oldest) * 1e-9
    for i in range(supervisors.ends.shape[0]):
        a, b = held.entry[s, supervisors.ends[i, 0], _POWER], held.entry[s, supervisors.ends[i, 1], _POWER]
        value[POWERS] = max(value[POWERS], abs(a + b) / max(abs(a), abs(b), MIN_POWER))
    value[LOCAL] = 0.0
    if row.state == FALLBACK:
        value[LOCAL] = (end_ns - max(row.reserve_ns, row.begun_ns)) * 1e-9


@compiled
def controller(supervisors: Supervisors, state: SupervisorState, s: int, end_ns: int, lapses: int) -> None:
    """Update the monitors of the controller; `lapses`: number of non-finite setpoints in this tick."""
    row, rate = state.rows[s], supervisors.settings[s].frame_rate
    value = row.values
    value[SILENT] = 0.0 if row.owed_ns == UNSET else (end_ns - row.owed_ns) * 1e-9
    value[NON_FINITE] = lapses + (1.0 if row.finite == 0 else 0.0)
    window = round(SATURATION * rate)
    value[SATURATED] = (
        max(_count(state.past[s], row.tick, window, -1.0), _count(state.past[s], row.tick, window, 1.0)) / window
    )
    value[REVERSALS] = 0.0
    for i in range(min(rate, row.tick + 1)):
        value[REVERSALS] += state.past[s, (row.tick - i) % state.past.shape[1], 3]
    if row.norm_at_start == 0.0:
        row.norm_at_start = row.norm
    value[WEIGHTS] = row.norm / row.norm_at_start if row.norm > 0.0 else 0.0
    value[LYAPUNOV] = max(0.0, -row.fall) / max(row.lyapunov, MIN_LYAPUNOV)


@compiled
def _count(past: Float2, tick: int, window: int, side: float) -> int:
    """Number of the last `window` ticks, this one included, with an output at its limit on one side (+1 or -1)."""
    total, size = 0, past.shape[0]
    for i in range(min(window, tick + 1)):
        if past[(tick - i) % size, 2] == side:
            total += 1
    return total


@compiled
def check_grid(supervisors: Supervisors, state: SupervisorState, s: int, devices: NDArray[Any]) -> None:
    """Update the monitors of the grid; those based on frames are NaN while data are unsound."""
    row, settings = state.rows[s], supervisors.settings[s]
    value = row.values
    value[DEVICE] = 0.0
    for d in range(supervisors.devices.shape[1]):
        place = supervisors.devices[s, d].place
        if place != UNSET and (devices[place].blocked > 0.0 or devices[place].released > 0.0):
            value[DEVICE] += 1.0
    before = value[ISLANDING]
    value[FREQUENCY] = value[ISLANDING] = value[HARM] = value[GROWING] = value[FORCED] = math.nan
    if unsound(supervisors, state, s):
        return
    if math.isnan(before):
        _count_turns_anew(state, s)
    value[FREQUENCY], value[ISLANDING] = _apart(supervisors, state, s)
    if settings.omega > 0.0:
        value[HARM], value[GROWING] = _harm(supervisors, state, s), _growth(supervisors, state, s)
        value[FORCED] = constancy(row.wave, row.slow[1] - state.phasors[s, 0, 0], row.effort, settings)


@compiled
def _apart(supervisors: Supervisors, state: SupervisorState, s: int) -> tuple[float, float]:
    """Largest frequency deviation, Hz, and largest change of an angle between two PMUs since the start, degrees."""
    held, worst, low, high = state.held, 0.0, math.inf, -math.inf
    for i in range(held.entry_ns.shape[1]):
        pmu = state.pmus[s, i]
        if held.uses[s, i] and held.entry_ns[s, i] != UNSET:
            worst = max(worst, abs(held.entry[s, i, _FREQUENCY] - supervisors.settings[s].nominal))
            moved = pmu.angle - pmu.angle_at_start
            low, high = min(low, moved), max(high, moved)
    return worst, math.degrees(max(0.0, high - low))


@compiled
def _count_turns_anew(state: SupervisorState, s: int) -> None:
    """Rewrap angles after unsound data, in which turns are lost: within half a turn of the first PMU's change."""
    held, first = state.held, math.nan
    for i in range(held.entry_ns.shape[1]):
        pmu = state.pmus[s, i]
        moved = pmu.angle - pmu.angle_at_start
        if held.uses[s, i] and held.entry_ns[s, i] != UNSET and math.isfinite(moved):
            first = moved if math.isnan(first) else first
            pmu.angle -= TURN * math.floor((moved - first) / TURN + 0.5)


@compiled
def unsound(supervisors: Supervisors, state: SupervisorState, s: int) -> bool:
    """Whether a monitor of data whose consequence is a fallback or trip exceeds its limit."""
    for m in range(LAST_OF_DATA + 1):
        if (
            supervisors.thresholds[s, m].follows >= FALL_BACK
            and state.rows[s].values[m] > supervisors.thresholds[s, m].limit
        ):
            return True
    return False


@compiled
def _harm(supervisors: Supervisors, state: SupervisorState, s: int) -> float:
    """Growth rate that the outputs add to the mode, 1/s: Re sum_d R_d u_d / y, with phasors u_d, y; 0 if none acts."""
    acts, total = False, 0.0
    for d in range(supervisors.devices.shape[1]):
        if supervisors.devices[s, d].place != UNSET:
            size = magnitude(complex(state.phasors[s, 1 + d, 1], state.phasors[s, 1 + d, 2]))
            acts = acts or size > ACTS * supervisors.devices[s, d].limit
            total += (supervisors.devices[s, d].residue * gain_of(supervisors, state, s, d)).real
    return total if acts else 0.0


@compiled
def constancy(wave: Float1, x: float, effort: float, settings: Any) -> float:
    """How constant the size of a signal without mean, x, is: 2 - 2/3 E x^4 / (E x^2)^2, by its kurtosis.

    1 for a sine wave, 0 for Gaussian noise; less for what decays or grows. V. D. Vrabie, P. Granjon, C. Serviere,
    Spectral kurtosis: from definition to application, IEEE-EURASIP NSIP 2003. A mode of damping sigma changes its size
    in 1/|sigma|: the exponential means forget in MEMORIES of these, and give NaN before. They begin anew with an event,
    and while `effort` is 1: what the controller drives at its limits is not forced. `wave`: as in SUPERVISOR.
    """
    square = x * x
    if effort >= 1.0 or square > ANEW * wave[1]:
        wave[:] = 0.0
    cycle = float(settings.cycle)
    memory = MEMORIES * settings.frame_rate / max(-settings.sigma, 1e-9)
    window = min(max(memory, SHORTEST * cycle), LONGEST * cycle)
    wave[0] = min(wave[0] + 1.0, window)
    for k, power in enumerate((square, square * square, effort * effort)):
        wave[1 + k] += (power - wave[1 + k]) / wave[0]
    if wave[0] < window:
        return math.nan
    answers = 2.0 * wave[3] > ANSWERS * ANSWERS and wave[1] > 0.0
    return 2.0 - wave[2] / (1.5 * wave[1] * wave[1]) if answers else 0.0


@compiled
def _growth(supervisors: Supervisors, state: SupervisorState, s: int) -> float:
    """Mean growth rate of the slow signal over three cycles minus the mode's open-loop rate sigma, 1/s.

    A cycle's growth rate: ln(range / range in the cycle before) / cycle. The value is 0 unless

    - the signal grows faster than sigma, less SLACK, in each of the three cycles: not by an event only;
    - in each of them the output exceeds WORKS and its slow part SWINGS: the controller may drive it;
    - the newest range is MORE times the earlier ones as they would be by now without control: `row.free` is the
      largest of them three cycles ago.
    """
    row, past, settings, size = state.rows[s], state.past[s], supervisors.settings[s], state.past.shape[1]
    cycle = settings.cycle
    if row.tick + 1 < CYCLES_KEPT * cycle:
        return 0.0
    least, newest, later, works = math.inf, 0.0, 0.0, True
    for k in range(CYCLES_KEPT):
        low, high, most, slow = math.inf, -math.inf, 0.0, 0.0
        for i in range(k * cycle, (k + 1) * cycle):
            place = past[(row.tick - i) % size]
            low, high = min(low, place[0]), max(high, place[0])
            most, slow = max(most, place[1]), max(slow, place[4])
        if k == 0:
            newest = high - low
        else:
            least = min(least, later / (high - low) if high > low else 0.0)
        works = works and (k == CYCLES_KEPT - 1 or (most > WORKS and slow > SWINGS))
        later = high - low
    fades, lasts = min(settings.sigma, -FORGET), (CYCLES_KEPT - 1) * cycle / settings.frame_rate
    row.free = max(row.free * exp(fades / settings.frame_rate), later)
    steady = least > exp((settings.sigma - SLACK) * cycle / settings.frame_rate)
    driven = steady and newest > MORE * row.free * exp(fades * lasts)
    return float(log(newest / later) / lasts - settings.sigma) if works and driven and later > 0.0 else 0.0
