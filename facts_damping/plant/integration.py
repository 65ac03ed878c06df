"""Integration over a time step, split exactly at setpoints, events and ends of reference ramps; compiled.

The caller owns the state; times are integer nanoseconds.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.compiling import compiled, entry_point
from facts_damping.plant.converters.first_order_lag import first_order_lag
from facts_damping.plant.dynamics import derivatives, set_machines
from facts_damping.plant.forced_oscillations import begin_oscillations, move_oscillations
from facts_damping.plant.load_noise import begin_noise, move_noise
from facts_damping.plant.measurement import write_phasors
from facts_damping.plant.model import Plant, PlantState, Work, begin_interval
from facts_damping.plant.network_response import respond, set_sources, several_solutions
from facts_damping.plant.prediction import keep_motion, moved, predict
from facts_damping.plant.watchdog import accepts, arrive, due_ns, release, send
from facts_damping.signals import NOT_YET, Setpoints

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1


@compiled
def _slopes(plant: Plant, state: PlantState, ramp: Float1, interval: int, elapsed: float, h: float, work: Work) -> None:
    """Slopes of a classical fourth-order Runge-Kutta step of `h` seconds; references move by `ramp` p.u./s.

    It begins `elapsed` seconds after the current segment of the loads' noise and of forced oscillations.

    `derivatives` is called at one place only, so that the compiler inlines it: a call would copy the plant's arrays.
    """
    x, k, trial, reference = state.x, work.slopes, work.trial, work.reference
    ahead = not several_solutions(plant)
    for part in range(4):
        if part == 0:
            for i in range(x.size):
                trial[i] = x[i]
            for d in range(reference.size):
                reference[d] = state.reference[d]
            move_noise(plant, work, elapsed)
            move_oscillations(plant, work, elapsed)
        else:
            fraction = h if part == 3 else 0.5 * h
            for i in range(x.size):
                trial[i] = x[i] + fraction * k[part - 1, i]
            _move_inputs(plant, state, ramp, elapsed, fraction, work)
        predict(part, h, ahead, state.source, state.source_motion, work.source_path)
        derivatives(plant, trial, reference, state.source, interval, k[part], work)
    keep_motion(h, state.source, state.source_motion, work.source_path)


@compiled
def _reference_after(state: PlantState, ramp: Float1, d: int, seconds: float) -> float:
    """Reference of device d after so many seconds, along its ramp up to its target, p.u."""
    move = ramp[d] * seconds
    arrived = abs(move) >= abs(state.target[d] - state.reference[d])
    return state.target[d] if arrived else state.reference[d] + move  # type: ignore[no-any-return]


@compiled
def _lag_after(row: Any, state: PlantState, ramp: Float1, d: int, seconds: float) -> float:
    """Output of device d's lag after so many seconds, p.u.: its reference moves along its ramp, then stands."""
    moves = seconds
    if ramp[d] != 0.0:
        moves = min(seconds, (state.target[d] - state.reference[d]) / ramp[d])
    z = first_order_lag(state.x[row.lag], state.reference[d], ramp[d], row.response_time, moves)
    if moves < seconds:
        z = first_order_lag(z, state.target[d], 0.0, row.response_time, seconds - moves)
    return z


@compiled
def _move_inputs(plant: Plant, state: PlantState, ramp: Float1, elapsed: float, seconds: float, work: Work) -> None:
    """Write what acts on the plant `seconds` after a step's begin: references with their lags, noise, oscillations.

    The lags of references are solved in closed form, so they are exact even if much shorter than the step.
    """
    for d in range(work.reference.size):
        work.reference[d] = _reference_after(state, ramp, d, seconds)
        if plant.devices[d].response_time > 0.0:
            work.trial[plant.devices[d].lag] = _lag_after(plant.devices[d], state, ramp, d, seconds)
    move_noise(plant, work, elapsed + seconds)
    move_oscillations(plant, work, elapsed + seconds)


@compiled
def _take_sample(
    plant: Plant, state: PlantState, ramp: Float1, interval: int, elapsed: float, h: float, seconds: float, work: Work
) -> None:
    """Write the network's inputs `seconds` after a step's begin: by the method's cubic, sources by their path.

    Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.6: of third order everywhere in a step.
    """
    x, k, part = state.x, work.slopes, seconds / h
    square, cube = part * part, part * part * part / 1.5
    first, middle, last = part - 1.5 * square + cube, square - cube, cube - 0.5 * square
    for i in range(x.size):
        work.trial[i] = x[i] + h * (first * k[0, i] + middle * (k[1, i] + k[2, i]) + last * k[3, i])
    _move_inputs(plant, state, ramp, elapsed, seconds, work)
    for p in range(work.source.size):
        work.source[p] = state.source[p] + moved(state.source_motion, p, seconds - h)
    set_machines(plant, work.trial, interval, work)
    set_sources(plant, work.source, work)
    respond(plant, interval, work)


@compiled
def _finish(plant: Plant, state: PlantState, ramp: Float1, h: float, work: Work) -> None:
    """Move the states by the slopes of a step, and the references along their ramps."""
    x, k = state.x, work.slopes
    for d in range(ramp.size):
        if plant.devices[d].response_time > 0.0:  # in place of its slopes
            work.trial[plant.devices[d].lag] = _lag_after(plant.devices[d], state, ramp, d, h)
    for i in range(x.size):
        x[i] += h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])
    for d in range(ramp.size):
        if plant.devices[d].response_time > 0.0:
            x[plant.devices[d].lag] = work.trial[plant.devices[d].lag]
        state.reference[d] = _reference_after(state, ramp, d, h)


@compiled
def _take_setpoints(plant: Plant, state: PlantState, setpoints: NDArray[Any], first: int, count: int, now: int) -> int:
    """Apply or queue the limited setpoints that are effective by `now`; return the index of the next one."""
    while first < count and setpoints[first].effective_ns <= now:
        d = setpoints[first].device
        row = plant.devices[d]
        if accepts(row.watchdog, state.watch[d], setpoints[first], row.setpoint_max, now):
            value = min(max(setpoints[first].value, -row.setpoint_max), row.setpoint_max)
            if row.dead_ns > 0:
                send(state.under_way, state.waiting, d, now + row.dead_ns, value)
            else:
                state.target[d] = value
        first += 1
    return first


@compiled
def _queue(
    plant: Plant, state: PlantState, setpoints: NDArray[Any], first: int, count: int, end: int
) -> tuple[int, int]:
    """Queue the setpoints before `end` that act after dead times; return the next one, and when something acts."""
    while first < count and setpoints[first].effective_ns < end:
        d, now = setpoints[first].device, setpoints[first].effective_ns
        if plant.devices[d].dead_ns == 0 or state.watch[d].released == 1:
            return first, now
        _take_setpoints(plant, state, setpoints, first, first + 1, now)
        first, end = first + 1, min(end, now + plant.devices[d].dead_ns)
    return first, end


@compiled
def _let_go(plant: Plant, state: PlantState, end: int, now: int) -> int:
    """Release devices whose time-out has passed, with target zero; return the next possible time, or `end`.

    A release is local to the device, so it has no dead time; queued setpoints are dropped.
    """
    for d in range(state.target.size):
        due = due_ns(plant.devices[d].watchdog, state.watch[d])
        if due > now:
            end = min(end, due)
        elif due != NOT_YET:
            release(state.watch[d])
        if state.watch[d].released == 1:
            state.target[d] = 0.0
            state.waiting[d] = 0
    return end


@compiled
def _ramp(plant: Plant, state: PlantState, ramp: Float1, end: int, now: int) -> int:
    """Write the slopes (p.u./s) of references towards their targets; return when the first without a lag arrives."""
    for d in range(ramp.size):
        gap = state.target[d] - state.reference[d]
        rate = plant.devices[d].rate_max
        if state.watch[d].released == 1:
            rate = min(rate, plant.devices[d].watchdog.release_rate)
        ramp[d] = 0.0
        if gap != 0.0:
            ramp[d] = math.copysign(rate, gap)
            if plant.devices[d].response_time == 0.0:
                end = min(end, now + max(1, math.ceil(abs(gap) / rate * 1e9)))
    return end


@entry_point
def watch(plant: Plant, state: PlantState, start_ns: int, end_ns: int, setpoints: Setpoints, count: int) -> None:
    """Run the devices' watchdogs from `start_ns` to `end_ns`, as in `advance`; the rest of the plant stands still."""
    now, following = start_ns, 0
    while now < end_ns:
        following = _take_setpoints(plant, state, setpoints, following, count, now)
        end = _let_go(plant, state, end_ns, now)
        if following < count:
            end = min(end, setpoints[following].effective_ns)
        now = end


@compiled
def _instant(start_ns: int, end_ns: int, k: int, parts: int) -> int:
    """The k-th of instants that divide an interval, rounded up: not before one on which an event may fall."""
    return start_ns + (k * (end_ns - start_ns) + parts - 1) // parts


@entry_point
def advance(
    plant: Plant, state: PlantState, start_ns: int, end_ns: int, setpoints: Setpoints, count: int, work: Work
) -> None:
    """Advance the plant in place from `start_ns` to `end_ns` with `count` setpoints, sorted by time.

    Setpoints, ends of dead times, events, points of the loads' noise, kinks of forced oscillations and ends of
    reference ramps without a lag split the interval exactly; each part has equal steps of at most `plant.step_ns`. A
    setpoint that first has a dead time splits nothing. The watchdog of each device decides which setpoints act, and
    when the device is released. `work.samples`: the PMUs' phasors at instants that divide the whole evenly, in steps.
    """
    now, following, ramp, written, samples = start_ns, 0, work.ramp, 0, work.samples.shape[0]
    due = _instant(start_ns, end_ns, 1, samples + 1)
    while now < end_ns:
        following = _take_setpoints(plant, state, setpoints, following, count, now)
        interval = begin_interval(plant, state, now)
        end = _let_go(plant, state, end_ns, now)
        end = arrive(state.under_way, state.waiting, state.target, end, now)
        following, end = _queue(plant, state, setpoints, following, count, end)
        if interval + 1 < plant.interval_start_ns.size:
            end = min(end, plant.interval_start_ns[interval + 1])
        end = begin_noise(plant, work, now, _ramp(plant, state, ramp, end, now))
        end = begin_oscillations(plant, work, now, end)
        steps = (end - now + plant.step_ns - 1) // plant.step_ns
        h = (end - now) * 1e-9 / steps
        for n in range(steps):
            _slopes(plant, state, ramp, interval, n * h, h, work)
            while written < samples and due < now + (n + 1) * (end - now) // steps:
                _take_sample(plant, state, ramp, interval, n * h, h, (due - now) * 1e-9 - n * h, work)
                write_phasors(plant, interval, work, work.samples[written])
                written += 1
                due = _instant(start_ns, end_ns, written + 1, samples + 1)
            _finish(plant, state, ramp, h, work)
        now = end
