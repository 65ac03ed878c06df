"""A step of adaptation, and each guard beside the raw rule."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.neurofuzzy.learning import FIXED, LYAPUNOV, LYAPUNOV_GROUPS, Rule, learners
from facts_damping.neurofuzzy.network import FLOOR, Pass, network
from facts_damping.neurofuzzy.start import Start, initial, slots
from tests.neurofuzzy.pupil import Pupil, adapt, every_pair, example, linear, looked, rule
from tests.neurofuzzy.test_network import at_parameters, differences
from tests.neurofuzzy.test_start import starts

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


@every_pair
@pytest.mark.parametrize("outputs", [1, 2])
def test_step_is_the_formula_with_differences_as_gradient(antecedent: str, consequent: str, outputs: int) -> None:
    """f + eta sum_p ec_p du_p/df + momentum of the consequents; three steps, each from where the last one led."""
    pupil, rng = example(antecedent, consequent, outputs), np.random.default_rng(2)
    net, eta, momentum = pupil.net, 0.01, 0.7
    with_momentum = np.arange(net.size) >= net.inputs * net.rules * net.stored
    change = np.zeros(net.size)
    for _ in range(3):
        before, error = pupil.theta, rng.uniform(-1, 1, outputs)
        gradient = differences(partial(at_parameters, net, pupil.learner.x[0]), before)
        change = eta * error @ gradient + momentum * change * with_momentum
        pupil.step(rule(eta, momentum=momentum), error)
        np.testing.assert_allclose(pupil.theta - before, change, rtol=1e-6, atol=1e-9 * max(1, np.abs(gradient).max()))


wild = st.builds(
    Rule,
    st.sampled_from([float(FIXED), float(LYAPUNOV), float(LYAPUNOV_GROUPS)]),
    st.floats(-3, 6).map(lambda power: 10.0**power),
    st.floats(0, 0.99),
    st.floats(0, 1),
    st.sampled_from([0.0, 1e-3, 1.0, 1e3]),
    st.just(1.0),
)


@every_pair
@settings(max_examples=8, deadline=None)
@given(start=starts(), rule=wild, seed=st.integers(0, 2**31))
def test_projection_keeps_any_history_of_learning_within_bounds(
    antecedent: str, consequent: str, start: Start, rule: Rule, seed: int
) -> None:
    """Errors up to 1e12, the largest plausible signal over the smallest scale."""
    net, rng = network(antecedent, consequent, 2, 2, 2), np.random.default_rng(seed)
    pupil = Pupil(net, initial(net, start), np.zeros(2))
    for _ in range(30):
        pupil.learner.x[0] = rng.uniform(-3, 3, 2)
        error = rng.choice([-1, 1], 2) * 10.0 ** rng.uniform(-3, 12, 2)
        pupil.step(rule, error, 10.0 ** rng.uniform(-6, 6, 2))
        assert pupil.within
        p = looked(net, pupil.theta, pupil.learner.x[0])
        assert all(np.isfinite(array).all() for array in (p.output, p.by_theta, p.by_input))


class Trouble(NamedTuple):
    """One outlier at x moves a parameter of the first rule to `wanted`; `sound` looks at the network after it."""

    antecedent: str
    consequent: str
    group: str
    wanted: float
    x: float
    sound: Callable[[Callable[[float], Pass], NDArray[np.float64]], bool]


TROUBLES = {
    "nothing fires any more": Trouble(
        *("gaussian", "singleton", "h", 50.0, 0.0),
        lambda look, _: any(look(x).total[0] > FLOOR for x in np.linspace(-3, 3, 61)),
    ),
    "a membership like a needle": Trouble(
        *("gaussian", "singleton", "s", 1e-3, 2.5),
        lambda look, f: bool(abs(look(f[0] + f[1] / np.sqrt(2)).mu_by_x[0, 0]) < 10),
    ),
    "a width below zero": Trouble(
        *("triangular", "singleton", "s", -1.0, 0.2), lambda look, _: look(0.2).mu.max() <= 1
    ),
    "a degree below zero": Trouble(
        *("b-spline", "singleton", "degree", -1.0, -1.0), lambda look, _: look(-1.0).mu.min() >= 0
    ),
    "a degree below zero, interpolated": Trouble(
        *("b-spline-interpolated", "singleton", "degree", -1.0, -1.0), lambda look, _: look(-1.0).mu.min() >= 0
    ),
    "a volume below zero: no mean any more": Trouble(
        *("gaussian", "sam", "V", -0.9, 0.2),
        lambda look, _: bool(look(0.2).zeta.min() <= look(0.2).output[0] <= look(0.2).zeta.max()),
    ),
    "a hat like a needle": Trouble(
        *("gaussian", "mexican-hat", "nu", 1e-5, 0.2),
        lambda look, f: bool(abs(look(f[5] + 0.3 * f[6]).zeta_by_x[0, 0, 0]) < 200),
    ),
    "a wavelet like a needle": Trouble(
        *("gaussian", "morlet", "nu", 1e-5, 0.2),
        lambda look, f: bool(abs(look(f[5] + 0.3 * f[6]).zeta_by_x[0, 0, 0]) < 200),
    ),
    "tanh saturated": Trouble(
        *("gaussian", "legendre", "w", 1e4, 0.2), lambda look, _: np.abs(look(0.2).by_theta).max() > 1e-9
    ),
}


@pytest.mark.parametrize("name", TROUBLES)
def test_outlier_breaks_the_raw_rule_and_not_projection(name: str) -> None:
    trouble = TROUBLES[name]
    net = network(trouble.antecedent, trouble.consequent, 1, 2, 1)
    theta, x = initial(net, Start([0.5], [0.1], [3.0], [0.3], [1.0])), np.array([trouble.x])
    f = [slot.group for slot in slots(net)].index(trouble.group)
    error = (trouble.wanted - theta[f]) / looked(net, theta, x).by_theta[0, f]
    raw, projected = Pupil(net, theta, x), Pupil(net, theta, x)
    raw.step(rule(), error)
    projected.step(rule(projection=1.0), error)
    assert raw.theta[f] == pytest.approx(trouble.wanted, rel=1e-6)
    assert not raw.within
    assert projected.within
    for now, sound in ((theta, True), (raw.theta, False), (projected.theta, True)):
        assert trouble.sound(lambda at, now=now: looked(net, now, np.array([at])), now) == sound  # type: ignore[misc]


def test_too_large_a_rate_diverges_and_projection_stands() -> None:
    raw, projected = linear([0.1, 0.2]), linear([0.1, 0.2])
    for _ in range(1000):
        raw.pursue(rule(5.0), 1.0)
        projected.pursue(rule(5.0, projection=1.0), 1.0)
    assert not np.isfinite(raw.theta).any()
    assert projected.within
    assert abs(projected.output[0]) <= 5 * 1.5


def test_leakage_bounds_what_a_lasting_error_makes_drift() -> None:
    """At the fixed point eta e g = leakage (f - start); without leakage f goes on, or to its bound."""
    start, eta, error, leakage, steps = [0.1, 0.2], 0.02, 0.5, 0.01, 4000
    slope = np.array([1.0, 0.5])
    raw, leaking, projected = linear(start), linear(start), linear(start)
    for _ in range(steps):
        raw.step(rule(eta), error)
        leaking.step(rule(eta, leakage=leakage), error)
        projected.step(rule(eta, projection=1.0), error)
    np.testing.assert_allclose(raw.theta[2:], start + steps * eta * error * slope, rtol=1e-9)
    np.testing.assert_allclose(leaking.theta[2:], start + eta * error * slope / leakage, rtol=1e-9)
    np.testing.assert_array_equal(projected.theta[2:], [5.0, 5.0])


@every_pair
@settings(max_examples=5, deadline=None)
@given(clip=st.floats(1e-3, 10), momentum=st.floats(0, 0.99))
def test_clip_is_the_longest_step(antecedent: str, consequent: str, clip: float, momentum: float) -> None:
    """One outlier of 1e6: a step of the same direction, as long as the clip, and momentum goes on from that."""
    raw, clipped = example(antecedent, consequent), example(antecedent, consequent)
    before = raw.theta
    raw.step(rule(0.02), 1e6)
    clipped.step(rule(0.02, momentum=momentum, clip=clip), 1e6)
    jump, move = raw.theta - before, clipped.theta - before
    assert np.linalg.norm(jump) > 100
    np.testing.assert_allclose(move, jump * clip / np.linalg.norm(jump), rtol=1e-6, atol=1e-12)
    for later in range(1, 5):
        before = clipped.theta
        clipped.step(rule(0.02, momentum=momentum, clip=clip), 0.0)
        assert np.linalg.norm(clipped.theta - before) <= clip * momentum**later + 1e-12


def test_clip_leaves_ordinary_steps_alone() -> None:
    raw, clipped = example("gaussian", "morlet"), example("gaussian", "morlet")
    for error in (0.1, -0.3, 0.2):
        raw.step(rule(0.02), error)
        clipped.step(rule(0.02, clip=1.0), error)
    np.testing.assert_array_equal(raw.theta, clipped.theta)


def test_leakage_leads_back_to_the_start() -> None:
    pupil = example("gaussian", "fourier")
    start = pupil.theta
    pupil.step(rule(0.5), 1.0)
    away = pupil.theta - start
    pupil.step(rule(leakage=0.25), 0.0)
    np.testing.assert_allclose(pupil.theta - start, 0.75 * away, rtol=0, atol=1e-14)


def test_learners_side_by_side_learn_as_each_alone() -> None:
    """Arrays hold the largest network: a smaller one beside it leaves alone what is beyond its own."""
    large, small = example("b-spline", "fourier", 2), example("gaussian", "morlet", 1)
    several, size = learners([large.net, small.net], [large.theta, small.theta]), small.net.size
    several.x[1, :2] = small.learner.x[0]
    for rate in (FIXED, LYAPUNOV, LYAPUNOV_GROUPS):
        now = rule(0.1, rate, momentum=0.3)
        small.step(now, 0.2)
        adapt(small.net, several, 1, now, np.array([0.2, 77.0]), np.ones(2))
    np.testing.assert_array_equal(several.theta[1, :size], small.theta)
    np.testing.assert_array_equal(several.theta[0], large.theta)
    assert not several.theta[1, size:].any()
