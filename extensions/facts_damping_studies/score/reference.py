"""The upper reference of a score: state feedback that knows the plant, its state, and what happens to it.

At each frame it sees the true state of the plant as it is in the case, changed or not, and sets all devices by

    u = -K [z; u(k-1) ... u(k-m)],  z = W (x - x_s)

x_s is the state without swings of the grid as it is now, z the part of the deviation that swings, in the modes of the
plant linearised there. K is optimal for these modes from frame to frame, with hold, dead times and delay, and minimises

    sum_k (sum_i dw_i(k)^2 + control_weight sum_p (u_p(k) / u_max,p)^2)                                 p.u.^2

with dw the speed differences of which the index is. With a delay the setpoints that have not acted yet are states, so
K contains the predictor of the state; where it would set more than half of a limit, swings are large, and the plant
itself is simulated over the delay in place of its linear model. It has neither PMUs nor links, and so none of their
faults: noise, losses, bad PMUs, a device that is lost and a wrong sign do not reach it. It is held to the limits, the
rates, the dead times and the lags of the devices. Like each controller it does not know what will happen; it knows
what has happened at once, or with its delay. No controller has that much, so none is expected to have less of the
index, though none is proved not to: K is optimal for small swings, for a sum of squares, and the index is ITAE.

In a case with events its run has no noise, as the index is of the response, which has none either; with the noise of
the loads, setpoints of a small device in WECC-240 are at their limits for most of the time, and swings are not damped.

In each case the law of CONTROL_WEIGHTS with the least index counts: where setpoints are at their limits, one that minds
them less may do harm (28 % after a fault in New England with a small SSSC). A scan of one weight for all, with noise,
in the nominal cases of the sets 1.0; change of the index in %, without delay, then with the delay of the case:

                 1e-8          3e-8          1e-7          3e-7          1e-6          1e-5          LQG
    two_area     -88.1 -87.8   -88.3 -88.0   -88.6 -88.2   -88.6 -88.3   -88.1 -87.7   -78.3 -77.8   -85.8
    nets_nyps    -55.9 -57.2   -57.4 -57.4   -57.6 -57.5   -57.5 -56.6   -53.6 -52.7   -31.4 -31.0   -38.5
    minniwecc    -42.6 -42.1   -45.3 -43.9   -42.4 -41.4   -30.8 -29.8   -15.2 -14.4    -2.0  -1.9    -9.2

With the state before the events for x_s, and the law of that grid, the delayed one has 46 % less instead of 96 % after
a fault and a trip of the tie.

A state without swings is where linearly implicit Euler steps of 1 s lead, which follow what is slower than they and
damp what is faster (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, IV.9). Loads, mechanical
powers and the network change in grades meanwhile, as at once they would bring regulators and governors to limits,
where a linearisation is blind. So it needs no equilibrium: after the loss of a load without governors there is none.
Source of K: G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems, 3rd ed. 1998, 9. Modes are
of LAPACK or ARPACK, so between processors figures differ by round-off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.measures import measure_weights
from facts_damping.caching import shared
from facts_damping.compiling.structs import Table
from facts_damping.errors import InputError
from facts_damping.link.stages import mean_delay
from facts_damping.numerics.matrices import riccati, solve
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.plant.dynamics import derivatives
from facts_damping.plant.events import topology_intervals
from facts_damping.plant.integration import advance
from facts_damping.plant.model import copy, workspace
from facts_damping.signals import NANOSECONDS, SETPOINT, to_ns
from facts_damping.simulation.assembly import build_plant
from facts_damping.simulation.loop import build_loop, record
from facts_damping.simulation.measured_plant import advance_with_pmus, measure_with_pmus, tick_ns
from facts_damping.simulation.parts import lent
from facts_damping.simulation.tick import AT
from facts_damping.small_signal import descriptor
from facts_damping.small_signal.descriptor import Descriptor
from facts_damping.small_signal.eigenmodes import eigenvectors
from facts_damping.small_signal.linearisation import linear_model, state_matrix
from facts_damping.small_signal.zero_order_hold import held_for
from facts_damping_studies.score.measure import Measured, measured_from

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.plant.build import Built
    from facts_damping.plant.model import Plant, PlantState
    from facts_damping.record import Record
    from facts_damping.simulation.tick import Loop

    Array = NDArray[np.float64]

CONTROL_WEIGHTS = 1e-7, 1e-6, 1e-5, 1e-4  # p.u.^2, of a setpoint at its limit
SLOWEST, FASTEST = 0.5, 30.0  # 1/s, magnitude of the eigenvalues of modes that are controlled
LARGE = 0.5  # of a limit: setpoints of large swings, over whose delay the nonlinear plant predicts
LEAST = 0.01  # effect of a mode that is controlled, relative to the largest
STEP_S, GRADES, SETTLING = 1.0, 8, 4  # of implicit Euler; steps while the grid changes, and after it
GRADUAL = ("mechanical_power", "load_scale", "network")
BY_INTERVAL = ("interval_start_ns", "mechanical_power", "online", "island", "load_scale", "network")

_swings: dict[str, list[SwingModel]] = {}  # by system, devices and events


class SwingModel(NamedTuple):
    """dz = A z + B u, dw = Z z: the swings of a grid about its state without swings, z = W (x - x_s)."""

    start_ns: int  # from when the grid is as it is
    plant: Plant  # this grid, without noise and events
    at: Array  # x_s, (states,)
    W: Array  # (swings, states)
    A: Array  # (swings, swings), 1/s
    B: Array  # (swings, devices)
    Z: Array  # (differences, swings)


class Law(NamedTuple):
    """State feedback from a time on."""

    swings: SwingModel
    K: Array  # (devices, swings + past setpoints), those of the frame before first
    K_ahead: Array  # likewise, for the state after the delay


def reference(
    case: Case, after: float, *, delayed: bool, control_weights: Sequence[float] = CONTROL_WEIGHTS
) -> Measured:
    """What `measure` is for a controller: the figures of the reference in a case until `after` (s) the last event.

    `delayed`: its setpoints act as late as those of a controller that answers at once, after the mean delays of uplink
    and downlink of the case's link. `control_weights`: of a setpoint at its limit, p.u.^2; the law with the least index
    counts. Controllers and supervision of the case are left out. Raises `InputError` if the plant cannot be built.
    """
    bare = replace(case, controllers=[], supervision=None, run=case.run.model_copy(update={"watchdog": None}))
    delay = mean_loop_delay(case) if delayed else 0.0
    if case.scenario.events:  # the index is of the response, which has no noise
        bare = noiseless(bare)
    figures = []
    for weight in control_weights:
        laws = [law(swings, case, delay, weight) for swings in swing_models(bare)]
        figures.append(measured_from(bare, run(bare, laws, delay), None, after))
    return min(figures, key=lambda of_one: np.inf if of_one.measure is None else of_one.measure)


def mean_loop_delay(case: Case) -> float:
    """Mean delay of the case's link in both directions, s."""
    return mean_delay(case.link.up) + mean_delay(case.link.down, case.run.devices)


def noiseless(case: Case) -> Case:
    """The case without the noise of loads and PMUs."""
    measurement = case.measurement.model_copy(update={"noise": type(case.measurement.noise)()})
    return replace(case, measurement=measurement, run=case.run.model_copy(update={"load_noise": None}))


def swing_models(case: Case) -> list[SwingModel]:
    """The swings of each grid without a fault that the events of a case lead to."""
    events = [event.model_dump_json() for event in case.scenario.events]
    key = f"{case.system.model_dump_json()} {case.run.devices} {events}"
    return shared(_swings, key, lambda: _all_swings(case), maximum=4)


def _all_swings(case: Case) -> list[SwingModel]:
    built = whole = build_plant(case)  # `built`: in the last interval without a fault
    models: list[SwingModel] = []
    for i, interval in enumerate(topology_intervals(case.system, case.scenario.events)):
        topology = interval.topology
        if all(place.line in topology.lines_out for place in topology.faults):
            after = in_interval(whole, i, built)
            built = after if i == 0 else _without_swings(built, after)
            models.append(_swings_of(case, built, interval.start_ns))
    return models


def in_interval(whole: Built, i: int, before: Built) -> Built:
    """A plant whose one grid is that of an interval, in the state of the one before."""
    plant = whole.plant
    parts = {name: getattr(plant, name)[i : i + 1] for name in BY_INTERVAL}
    networks = Table([plant.sparse_networks[i]] if len(plant.sparse_networks) else [])
    return whole._replace(plant=plant._replace(**parts, sparse_networks=networks), state=before.state)


def _without_swings(before: Built, after: Built) -> Built:
    """The plant after a change, in its state without swings; the change comes in as many grades as `GRADES`."""
    state = before.state
    for k in range(1, GRADES + SETTLING + 1):
        grade = min(1.0, k / GRADES)
        parts = {n: (1.0 - grade) * getattr(before.plant, n) + grade * getattr(after.plant, n) for n in GRADUAL}
        graded = after._replace(plant=after.plant._replace(**parts), state=state)
        plant, slope, source = graded.plant, np.zeros_like(state.x), state.source.copy()
        derivatives(plant, state.x, state.reference, source, 0, slope, workspace(plant, state))
        A = state_matrix(graded)[0]
        if isinstance(A, Descriptor):
            move = descriptor.solved(A, 1.0 / STEP_S, slope).real
        else:
            move = np.linalg.solve(np.eye(len(A)) / STEP_S - A, slope)
        state = state._replace(x=state.x + move, source=source)
    return after._replace(state=state)


def _swings_of(case: Case, built: Built, start_ns: int) -> SwingModel:
    """The swings of a plant about its state, with a real pair of states for each pair of complex modes."""
    A, B = state_matrix(built)
    values, left, right = eigenvectors(A)
    swinging = (np.abs(values) > SLOWEST) & (np.abs(values) < FASTEST) & (values.imag >= 0.0)
    values, left, right = values[swinging], left[:, swinging], right[:, swinging]
    left = left / np.einsum("im,im->m", left, right)
    Z = speed_differences(case, built)
    effect = np.linalg.norm(left.T @ B, axis=1) * np.linalg.norm(Z @ right, axis=0) / np.abs(values.real)
    chosen = effect >= LEAST * effect.max(initial=0.0)
    values, left, right = values[chosen], left[:, chosen], right[:, chosen]
    turning = values.imag > 0.0
    W = np.vstack([np.where(turning, 2.0, 1.0)[:, None] * left.real.T, -2.0 * left.imag.T[turning]])
    V = np.hstack([right.real, right.imag[:, turning]])
    pairs = np.flatnonzero(turning)
    modal = np.diag(np.concatenate([values.real, values.real[turning]]))
    partner = len(values) + np.arange(len(pairs))
    modal[pairs, partner], modal[partner, pairs] = values.imag[turning], -values.imag[turning]
    plant = built.plant._replace(load_noise=built.plant.load_noise[:0], oscillations=built.plant.oscillations[:0])
    return SwingModel(start_ns, plant, built.state.x, W, modal, W @ B, Z @ V)


def speed_differences(case: Case, built: Built) -> Array:
    """Rows of the speed differences of the index in terms of the states, (differences, states)."""
    rows, names = {pmu.name: f"{pmu.machine}.omega" for pmu in case.system.pmus}, built.state_names
    weights = list(measure_weights(case.document()).values())
    rotorless = sorted({pmu for parts in weights for pmu in parts if rows[pmu] not in names})
    signals = {pmu: Signal(channel="frequency", weights={pmu: 1.0}) for pmu in rotorless}
    frequencies = linear_model(built, signals, list(rows)).C if rotorless else np.zeros((0, len(names)))
    Z = np.zeros((len(weights), len(names)))
    for i, parts in enumerate(weights):
        for pmu, weight in parts.items():
            if pmu in rotorless:
                Z[i] += weight * frequencies[rotorless.index(pmu)]
            else:
                Z[i, names.index(rows[pmu])] += weight
    return Z


def law(swings: SwingModel, case: Case, delay: float, control_weight: float) -> Law:
    """The optimal feedback of a grid whose setpoints act after a delay (s)."""
    late = _gain(swings, case, delay, control_weight)
    return Law(swings, late, late if delay == 0.0 else _gain(swings, case, 0.0, control_weight))


def _gain(swings: SwingModel, case: Case, delay: float, control_weight: float) -> Array:
    """K of u(k) = -K [z(k), u(k-1), ..., u(k-m)], by Riccati's equation of swings and past setpoints."""
    devices, rate = [case.system.device(name) for name in case.run.devices], case.run.frame_rate
    limits = np.array([device.setpoint_max for device in devices])
    Phi, steps = onward(swings, rate, [delay + device.dead_time for device in devices])
    n, many, past = len(Phi), len(devices), len(steps) - 1
    A, B = np.zeros((n + past * many, n + past * many)), np.zeros((n + past * many, many))
    A[:n, :n], B[:n] = Phi, steps[0] * limits
    A[:n, n:] = np.hstack([step * limits for step in steps[1:]] or [np.zeros((n, 0))])
    if past:
        B[n : n + many] = np.eye(many)
        A[n + many :, n:-many] = np.eye((past - 1) * many)
    Z = np.hstack([swings.Z, np.zeros((len(swings.Z), past * many))])
    try:
        X = riccati(A, B, Z.T @ Z / control_weight, np.eye(many))
    except np.linalg.LinAlgError as error:
        text = f"devices: {', '.join(case.run.devices)} given, which cannot stabilise {case.system.name}"
        raise InputError(f"{text}; allowed: others") from error
    K = solve(np.eye(many) + B.T @ X @ B, B.T @ X @ A)
    scaled: Array = limits[:, None] * K / np.concatenate([np.ones(n), np.tile(limits, past)])
    return scaled


def onward(swings: SwingModel, frame_rate: int, delays: Sequence[float]) -> tuple[Array, list[Array]]:
    """Phi and H of z(k+1) = Phi z(k) + sum_j H_j u(k-j), with a delay (s) of each device's setpoints; exact."""
    period, whole = 1.0 / frame_rate, [divmod(to_ns(delay) * frame_rate, NANOSECONDS) for delay in delays]
    steps = [np.zeros(swings.B.shape) for _ in range(max(f + (rest > 0) for f, rest in whole) + 1)]
    for d, (f, rest) in enumerate(whole):
        part, b = rest / NANOSECONDS * period, swings.B[:, [d]]
        to_end, new = held_for(swings.A, b, period - part)
        steps[f][:, [d]] += new
        if rest:
            steps[f + 1][:, [d]] += to_end @ held_for(swings.A, b, part)[1]
    return held_for(swings.A, swings.B, period)[0], steps


def run(case: Case, laws: Sequence[Law], delay: float) -> Record:
    """A run of the plant of a case without controllers under the laws."""
    with lent() as part:
        loop = build_loop(case, part=part)
        _run_ticks(loop, case, laws, to_ns(delay))
        return record(case, loop)


def _run_ticks(loop: Loop, case: Case, laws: Sequence[Law], delay_ns: int) -> None:
    """All ticks, or until the plant is no longer sound: measure, set, advance."""
    measured, trace, rate = loop.measured, loop.signals, case.run.frame_rate
    limits = np.array([case.system.device(name).setpoint_max for name in case.run.devices])
    sent, waiting = np.zeros(max(law.K.shape[1] for law in laws)), np.zeros(0, SETPOINT)
    for tick in range(case.ticks):
        start, end = tick_ns(tick, rate), tick_ns(tick + 1, rate)
        frame, stamps, status = trace.frames[tick], trace.measured_ns[tick], trace.status[tick]
        sound = measure_with_pmus(measured, tick, frame, stamps, status, trace.machines[tick], trace.devices[tick])
        trace.time_ns[tick], trace.in_synchronism[tick], trace.used[AT.ticks] = start, sound, tick + 1
        if not sound:
            return
        now = [law for law in laws if law.swings.start_ns <= start][-1]
        u = _feedback(now.swings, now.K, measured.plant_state.x, sent)
        if delay_ns and (np.abs(u) > LARGE * limits).any():
            ahead = _ahead(now.swings.plant, measured.plant_state, (start, start + delay_ns), waiting)
            u = _feedback(now.swings, now.K_ahead, ahead, sent)
        u = np.clip(u, -limits, limits)
        sent = np.concatenate([u, sent[: -len(u)]])
        rows = np.zeros(len(u), SETPOINT)
        rows["tick"], rows["device"], rows["value"] = tick, np.arange(len(u)), u
        rows["measured_ns"] = rows["issued_ns"] = start
        rows["effective_ns"] = start + delay_ns
        waiting = np.concatenate([waiting, rows])
        due = int(np.searchsorted(waiting["effective_ns"], end))
        advance_with_pmus(measured, tick, waiting[:due], due)
        waiting = waiting[due:]


def _feedback(swings: SwingModel, K: Array, x: Array, sent: Array) -> Array:
    """Setpoints before limits; `sent`: past ones, the last first."""
    z = swings.W @ (x - swings.at)
    u: Array = -K @ np.concatenate([z, sent[: K.shape[1] - len(z)]])
    return u


def _ahead(plant: Plant, state: PlantState, span_ns: tuple[int, int], waiting: NDArray[Any]) -> Array:
    """State at the end of a span of time, in which what was sent acts, and nothing else happens."""
    later = copy(state)
    advance(plant, later, *span_ns, waiting, len(waiting), workspace(plant, later))
    return later.x
