"""The linearised loop with delay: against the nonlinear loop, closed forms, and a brute-force simulation."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.link.stages import mean_delay
from facts_damping.signals import NANOSECONDS, to_ns
from facts_damping.simulation import loop
from facts_damping.small_signal import sampled_output
from facts_damping.small_signal.linearisation import LinearModel, weights_of
from facts_damping_studies.margins.halved_steps import halvings, samples
from facts_damping_studies.margins.linear_closed_loop import (
    DelayedLoop,
    Discrete,
    approximate,
    delayed_loop,
    eigen,
    link_delays,
    pade,
    sampled,
    with_delay,
)
from facts_damping_studies.margins.unsupervised import unsupervised
from tests.appendix_b import lead_lag
from tests.plant.inverters import following

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case

some = settings(deadline=None, max_examples=25)
FRAME = 1.0 / 60.0

# With a price at which its setpoints move so little from frame to frame that ramps are steps.
LQG = ["controllers.0.name=LQG", "controllers.0.parameters.control_weight=1e-6"]
INVERTER, AT_INVERTER = following("I1", "B6", 60.0, Q=10.0)
POD = {"name": "pod", "kind": "inverter_input", "inverter": "I1", "input": "Vplant", "response_time": 0.01}
# Controllers of the nonlinear loop, each with its own device: signal, device, gain.
SETS = {
    "speed": ["controllers.0.signals=[speed]"],
    "behind a washout": ["controllers.0.signals=[power_rate]", "controllers.0.parameters.gain=0.05"],
    "with feed-through": [
        "devices=[statcom]",
        "controllers.0.devices=[statcom]",
        "controllers.0.signals=[voltage]",
        "controllers.0.parameters.gain=0.5",
    ],
    "through the plant control of an inverter": [
        f"system.inverters={json.dumps([INVERTER])}",
        f"system.inverter_controls={json.dumps(AT_INVERTER)}",
        f"system.devices.1={json.dumps(POD)}",
        "devices=[pod]",
        "controllers.0.devices=[pod]",
        "controllers.0.signals=[speed]",
        "controllers.0.parameters.gain=5.0",
    ],
    "LQG": [*LQG, "controllers.0.parameters.measurement_noise=0.01"],
    "LQG, two signals": [*LQG, "controllers.0.signals=[power_rate, w13]"],
    "two, each over its own link": [
        "devices=[sssc, statcom]",
        "controllers.0.signals=[speed]",
        "controllers.0.link=ideal",
        "controllers.1.name=LLC",
        "controllers.1.devices=[statcom]",
        "controllers.1.signals=[w13]",
        "controllers.1.link.up.0.delay=0.0213",
    ],
}
DELAYS = {
    "none": (0.0, 0.0),
    "a part of a frame": (0.004, 0.003),
    "up alone": (0.0123, 0.0),
    "whole frames": (0.05, 0.05),
    "frames and a part": (0.0312, 0.0922),
}
TICKS = 240


@cache
def case_of(which: str, up: float = 0.0, down: float = 0.0) -> Case:
    rows = [*SETS[which], "scenario=[]", f"duration={TICKS / 60}"]
    case = load_case(None, rows)
    for i, link in enumerate(case.links):
        has = mean_delay(link.up)
        place = f"controllers.{i}.link" if which.startswith("two") else "link"
        rows += [f"{place}.up.0.delay={up + has!r}", f"{place}.down.0.delay={down!r}"]
    return load_case(None, rows)


@cache
def linear_of(which: str) -> DelayedLoop:
    return delayed_loop(case_of(which))


@pytest.mark.parametrize("which", SETS)
@pytest.mark.parametrize("ways", DELAYS)
def test_frame_by_frame_it_moves_as_the_nonlinear_loop(which: str, ways: str) -> None:
    """All speeds disturbed by about 1e-7 p.u.: signals of 240 frames, and every setpoint applied, to linear order."""
    case = case_of(which, *DELAYS[ways])
    parts = loop.build_loop(case)
    disturbance = np.zeros(len(parts.measured.plant_state.x))
    speeds = [i for i, name in enumerate(linear_of(which).names) if name.endswith(".omega")]
    disturbance[speeds] = 1e-7 * np.random.default_rng(1).normal(size=len(speeds))
    still = loop.run(case)
    parts.measured.plant_state.x[:] += disturbance
    record = loop.finish(case, parts)

    linear, delay = delayed_loop(case), sum(DELAYS[ways])
    signals, setpoints = followed(linear, delay, disturbance, len(record.time_ns))
    pmus = [pmu.name for pmu in case.system.pmus]
    weights = np.array([weights_of(signal, pmus, case.system.frequency) for signal in case.system.signals.values()])
    seen = np.einsum("tsc,nsc->tn", np.nan_to_num(record.frames - still.frames[0]), weights)
    size = np.abs(seen).max(axis=0)
    used = [signal for c in linear.controllers for signal in c.signals]
    assert (size[used] > 1e-8).all()
    assert (np.abs(seen - signals)[:, used].max(axis=0) < 2e-3 * size[used]).all()
    for c in range(len(linear.controllers)):
        values = record.applied["value"][record.applied["controller"] == c]
        assert len(values) > TICKS - 20
        assert np.abs(values).max() > 1e-9
        assert np.abs(values - setpoints[: len(values), c]).max() < 2e-3 * np.abs(values).max()


def followed(
    linear: DelayedLoop, delay: float, x: NDArray[np.float64], ticks: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Signals (ticks, signals) and setpoints (ticks, controllers) from a state of the plant on.

    At the first frame a lead-lag gives nothing, and its first memory is the signal: that is frame 1's state. An LQG
    acts at once, and the memory of a washout is the signal.
    """
    matrix, model = sampled(linear, delay), linear.model
    state = np.zeros(len(matrix))
    state[: len(x)] = x
    signals, setpoints = np.zeros((ticks, len(model.C))), np.zeros((ticks, len(linear.controllers)))
    signals[0] = model.C @ x
    first = 0 if "LQG" in linear.names[len(x)] else 1
    if first:
        state[: len(x)] = sampled(linear._replace(controllers=[]), 0.0) @ x
    memories = np.cumsum([len(x), *(len(c.A) for c in linear.controllers)])
    waiting = [to_ns(delay + c.extra_delay) * linear.frame_rate // NANOSECONDS + 1 for c in linear.controllers]
    oldest = memories[-1] + np.cumsum(waiting) - 1  # places of the setpoints in force
    for c, at in zip(linear.controllers, memories, strict=False):
        if first or linear.model.washout[c.signals[0]] > 0.0:
            state[at] = signals[0, c.signals[0]]
    for k in range(first, ticks):
        signals[k] = model.C @ state[: len(x)]
        for c, at in zip(linear.controllers, oldest, strict=True):
            signals[k] += model.D[:, c.devices[0]] * state[at]
        for i, c in enumerate(linear.controllers):
            memory = state[memories[i] : memories[i + 1]]
            setpoints[k, i] = c.C[0] @ memory + c.D[0] @ signals[k, c.signals]
        state = matrix @ state
    return signals, setpoints


@pytest.mark.parametrize(("signal", "washout"), [("speed", None), ("power", 10.0), ("power_rate", 0.05)])
@pytest.mark.parametrize("rate", [25, 60, 120])
def test_controllers_are_the_bilinear_transform_of_their_transfer_function(
    signal: str, washout: float | None, rate: int
) -> None:
    """Gain and phase at z = exp(i w T), against the formula of appendix B at s = 2/T (z - 1)/(z + 1)."""
    (c,) = delayed_loop(load_case(None, [f"controllers.0.signals=[{signal}]", f"frame_rate={rate}"])).controllers
    for hertz in (0.05, 0.63, 1.2, 5.0):
        z = np.exp(2j * np.pi * hertz / rate)
        gain_found = c.C @ np.linalg.solve(z * np.eye(len(c.A)) - c.A, c.B) + c.D
        s = 2 * rate * (z - 1) / (z + 1)
        expected = lead_lag(s) * (1.0 if washout is None else s * washout / (1 + s * washout))
        assert gain_found[0, 0] == pytest.approx(expected, rel=1e-6)


def test_linearised_loop_is_the_same_when_built_twice() -> None:
    """The same model twice, and a run after it with the bits of one before."""
    case = case_of("speed")
    first, second = delayed_loop(case), delayed_loop(case)
    for a, b in zip(first.controllers[0][:4], second.controllers[0][:4], strict=True):
        np.testing.assert_array_equal(a, b)


def integrator(gain: float, rate: int) -> DelayedLoop:
    """dx/dt = u, u = -gain x."""
    model = LinearModel(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), np.zeros(1))
    proportional = Discrete(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[-gain]]), [0], [0])
    return DelayedLoop(model, [proportional], rate, ["x"], np.zeros((1, 0)), halvings(model.A, model.B, 1 / rate))


@some
@given(gain=st.floats(0.1, 100), delay_ns=st.integers(0, 300_000_000), rate=st.sampled_from([10, 60, 120]))
def test_integrator_has_its_polynomial(gain: float, delay_ns: int, rate: int) -> None:
    """z^(n+1) (z - 1) + K (T - p) z + K p = 0 for a delay of n frames and a part p (Astrom, Wittenmark, 2.3)."""
    frames, rest = divmod(delay_ns * rate, 10**9)
    period, part = 1 / rate, rest / 1e9 / rate
    polynomial = np.zeros(frames + 3)
    polynomial[:2] = 1.0, -1.0
    polynomial[-2:] += gain * (period - part), gain * part
    matrix = sampled(integrator(gain, rate), delay_ns / 1e9)
    np.testing.assert_allclose(np.poly(matrix), polynomial, rtol=0, atol=1e-9 * (1 + gain))


@some
@given(
    states=st.integers(1, 4),
    delay=st.floats(0, 0.2),
    lag=st.floats(0, 0.05),
    seed=st.integers(0, 10_000),
)
def test_any_small_plant_moves_as_events_in_time_say(states: int, delay: float, lag: float, seed: int) -> None:
    """Two controllers of a random plant, with feed-through, against SciPy's integration from event to event."""
    delay, lag = round(delay, 9), round(lag, 9)
    linear = random_loop(states, lag, seed)
    x0, ticks = np.random.default_rng(seed + 1).normal(size=states), 25
    matrix = sampled(linear, delay)
    state = np.r_[x0, np.zeros(len(matrix) - states)]
    for _ in range(ticks):
        state = matrix @ state
    expected = by_events(linear, [delay, delay + lag], x0, ticks)
    np.testing.assert_allclose(state[:states], expected, rtol=0, atol=1e-6 * (1 + np.abs(expected).max()))


@some
@given(per_frame=st.integers(1, 16), switch=st.floats(0, FRAME), seed=st.integers(0, 10_000))
def test_samples_of_pmus_from_steps_are_those_from_exponentials(per_frame: int, switch: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    A, B, rate = 20.0 * rng.normal(size=(4, 4)), rng.normal(size=(4, 2)), 60.0 * per_frame
    C, D = rng.normal(size=(3, 4)), rng.normal(size=(3, 2))
    filters = sampled_output.Filtered(C, D, np.ones((3, 1 + per_frame)), per_frame, rate, 0.0)
    x, old, new = rng.normal(size=(4, 5)), rng.normal(size=(1, 5)), rng.normal(size=(1, 5))
    inputs = [([0], old, new, switch), ([1], new, old, FRAME)]
    onward = halvings(A, B, 1.0 / rate)[0][0]
    ours = samples(filters, A, B, halvings(A, B, FRAME), onward, x, inputs)
    np.testing.assert_allclose(ours, sampled_output.samples(filters, A, B, x, inputs), rtol=0, atol=1e-11)


def random_loop(states: int, lag: float, seed: int) -> DelayedLoop:
    """A plant of random numbers with two inputs and two signals, and two first-order controllers."""
    rng = np.random.default_rng(seed)
    model = LinearModel(
        rng.normal(size=(states, states)) - np.eye(states),
        rng.normal(size=(states, 2)),
        rng.normal(size=(2, states)),
        0.3 * rng.normal(size=(2, 2)),
        np.zeros(2),
    )
    controllers = []
    for i in range(2):
        (num, den), dt = rng.normal(size=(2, 2)), 1 / 20
        A, B, C, D, _ = cont2discrete(
            (np.array([[-abs(den[0])]]), np.array([[1.0]]), np.array([[num[0]]]), np.array([[num[1]]])), dt, "bilinear"
        )
        controllers.append(Discrete(A, B, C, D, [1 - i], [i], i * lag))
    names = [f"x{i}" for i in range(states)] + ["z0", "z1"]
    return DelayedLoop(model, controllers, 20, names, np.zeros((states, 0)), halvings(model.A, model.B, 1 / 20))


def by_events(linear: DelayedLoop, delays: Sequence[float], x: NDArray[np.float64], ticks: int) -> NDArray[np.float64]:
    """The plant's state after some frames: measure, then let setpoints take effect at their instants, one by one."""
    model, period = linear.model, NANOSECONDS // linear.frame_rate
    z, u = [np.zeros(len(c.A)) for c in linear.controllers], np.zeros(2)
    waiting: list[tuple[int, int, float]] = []
    for k in range(ticks):
        now, end = k * period, (k + 1) * period
        y = model.C @ x + model.D @ u
        for i, c in enumerate(linear.controllers):
            waiting.append((now + to_ns(delays[i]), c.devices[0], float(c.C[0] @ z[i] + c.D[0] @ y[c.signals])))
            z[i] = c.A @ z[i] + c.B @ y[c.signals]
        waiting.sort(key=lambda event: event[0])
        while now < end:
            while waiting and waiting[0][0] <= now:
                _, device, u[device] = waiting.pop(0)
            until = min(end, waiting[0][0]) if waiting else end
            held = model.B @ u

            def slope(_t: float, v: NDArray[np.float64], held: NDArray[np.float64] = held) -> NDArray[np.float64]:
                return np.asarray(model.A @ v + held)

            x = solve_ivp(slope, (0.0, (until - now) / NANOSECONDS), x, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
            now = until
    return x


@some
@given(delay=st.floats(1e-4, 2.0), order=st.integers(2, 8), w=st.floats(0.01, 1.0))
def test_pade_terms_turn_by_the_delay_and_keep_the_size(delay: float, order: int, w: float) -> None:
    """Magnitude 1 at any frequency; the phase, up to w delay = 1, that of the delay."""
    A, B, C, D = pade(delay, order)
    s = 1j * w / delay
    value = complex((C @ np.linalg.solve(s * np.eye(order) - A, B) + D)[0, 0])
    assert abs(value) == pytest.approx(1.0, abs=1e-9)
    assert value == pytest.approx(np.exp(-1j * w), abs=2e-3 if order == 2 else 1e-4)


def test_pade_terms_without_delay_are_one() -> None:
    A, B, C, D = pade(0.0, 6)
    assert (A.shape, B.shape, C.shape, D.tolist()) == ((0, 0), (0, 1), (1, 0), [[1.0]])


# With a delay that it does not reckon with the LQG of two signals swings at 12 Hz, for which a term of order 6 is none.
@pytest.mark.parametrize("which", [which for which in SETS if which != "LQG, two signals"])
def test_pade_loops_near_the_sampled_ones(which: str) -> None:
    """Order 6, the hold as half a frame, at 100 ms: growth to 2e-3 1/s."""
    linear = linear_of(which)
    growth = eigen(linear, sampled(linear, 0.1)).growth
    other = eigen(linear, approximate(linear, 0.1, 6, FRAME / 2), discrete=False).growth
    assert growth == pytest.approx(other, abs=2e-3)


@pytest.mark.parametrize(
    ("sets", "count"),
    [
        ([], 2),  # all rotors turned, all speeds raised
        ([f"system.governors.{g}.enabled=true" for g in range(4)], 1),
        (["controllers.0.signals=[g1]", "system.signals.g1={channel: speed_deviation, weights: {G1: 1}}"], 1),
        ([f"system.machines.{g}.D=0.01" for g in range(4)], 1),
        (["system=smib"], 0),
        ([f"system.stabilisers.{g}.enabled=true" for g in range(4)], 2),
        (["system=nets_nyps"], 2),
    ],
    ids=[
        "two_area",
        "with governors",
        "a signal that is no difference",
        "a little damping",
        "infinite bus",
        "stabilisers",
        "nets_nyps",
    ],
)
def test_motions_that_nothing_answers_are_left_out(sets: list[str], count: int) -> None:
    """And nothing else: the plant's other eigenvalues stay, with a controller that gives nothing."""
    linear = delayed_loop(load_case(None, ["scenario=[]", "duration=1", "controllers.0.parameters.gain=0", *sets]))
    assert linear.rigid.shape[1] == count
    eigenvalues = eigen(linear, sampled(linear, 0.05)).values
    plant = np.linalg.eigvals(linear.model.A)
    away = plant[np.argsort(np.abs(plant))[count:]]
    slow = away[away.real > -20]
    assert len(slow) > 5
    for value in slow:
        assert np.abs(eigenvalues - value).min() < 1e-5 * (1 + abs(value))
    assert len(eigenvalues) == len(eigen(linear, sampled(linear, 0.05)).right.T)


def test_events_of_the_scenario_do_not_count() -> None:
    """Also one at the very start, after which the loop is not at rest."""
    out = "scenario=[{time: 0.0, kind: line_out, line: line_1}]"
    at_rest, other = (delayed_loop(load_case(None, [row, "duration=1"])) for row in ("scenario=[]", out))
    np.testing.assert_array_equal(sampled(at_rest, 0.1), sampled(other, 0.1))


def test_links_keep_how_much_longer_they_are() -> None:
    case = case_of("two, each over its own link")
    assert [c.extra_delay for c in delayed_loop(case).controllers] == [0.0, pytest.approx(0.0213)]
    assert link_delays(load_case(None, ["link=pdci"])) == [pytest.approx(0.082)]  # the mean of one that jitters
    late = with_delay(case, 0.05)
    assert [mean_delay([*x.up, *x.down]) for x in late.links] == pytest.approx([0.05, 0.0713])
    assert [c.extra_delay for c in delayed_loop(late).controllers] == [0.0, pytest.approx(0.0213)]


@pytest.mark.parametrize(
    ("sets", "named"),
    [
        (["controllers=[]"], "controllers: none given"),
        (["controllers.0.name=HBsWC"], "controllers.0.name: 'HBsWC@two_area' given"),
        (["controllers.0.name=ANFTSC", "controllers.0.scheme=direct"], "controllers.0.name: 'ANFTSC@two_area' given"),
        (["link.down.0.delay=0.1", "link.down.0.start=1"], "link: .* given; allowed: the same delay for all"),
    ],
)
def test_case_without_a_linear_margin_is_refused(sets: list[str], named: str) -> None:
    with pytest.raises(InputError, match=named):
        delayed_loop(load_case(None, sets))


def test_supervisors_and_fallbacks_have_no_part_in_the_linear_loop() -> None:
    """A fallback that adapts, by a link that is shorter: neither counts."""
    plain = load_case("two_area_small", ["link=delay_100ms"])
    reserve = "controllers.+={name: ANFTSC, scheme: direct, fallback_of: 0, signals: [power], link: ideal}"
    guarded = load_case("two_area_small", ["link=delay_100ms", "supervision=standard", "arm_at=1", reserve])
    assert len(guarded.controllers) == len(guarded.links) == 2
    expected = eigen(delayed_loop(plain), sampled(delayed_loop(plain), 0.1))
    spectrum = eigen(delayed_loop(guarded), sampled(delayed_loop(guarded), 0.1))
    assert spectrum.values.tobytes() == expected.values.tobytes()
    left = unsupervised(guarded)
    assert (link_delays(left), left.run.supervision, left.supervision, left.run.arm_at) == (
        link_delays(plain),
        None,
        None,
        None,
    )
    assert unsupervised(plain) is plain
