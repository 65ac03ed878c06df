"""Neuro-fuzzy controllers, frame by frame, against a controller of its own in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.neurofuzzy.learning import REGULAR
from facts_damping.neurofuzzy.network import FLOOR, Network
from facts_damping.neurofuzzy.table import VARIANTS
from tests.control.bench import CHANGE_SCALE, LIMITS, PMUS, SCALE, SIGN, Bench, Entry, controller, llc, raw, wide

SCHEMES = ("direct", "indirect")
LIMIT = LIMITS["first"][0]


class Reference:
    """ANFTSC in NumPy: (3.6), (3.8), (4.2), (4.6), (4.7), (4.12), (D.1), no guard; `theta` is h, s by input, and w."""

    def __init__(self, spread: float, width: float, weight: float, eta: float, hbar: float, momentum: float) -> None:
        self.h = np.full((2, 2), spread) * [-1, 1]  # (inputs, rules)
        self.s = np.full((2, 2), width)
        self.w = SIGN * weight * np.array([-1, 1])
        self.eta, self.hbar, self.momentum = eta, hbar, momentum
        self.y: float | None = None
        self.u, self.last = 0.0, np.zeros(2)
        self.slopes: list[Any] = []

    @property
    def theta(self) -> Any:
        return np.concatenate([np.stack([self.h, self.s], axis=2).ravel(), self.w])

    def frame(self, y: float, frames: int, J: float) -> float:
        """The setpoint on a measured `y`, p.u.; `J` is normalised."""
        if self.y is not None:
            ec = -y / SCALE * J - self.hbar * self.u
            by_h, by_s, by_w = self.slopes
            before = self.w
            self.h, self.s = self.h + self.eta * ec * by_h, self.s + self.eta * ec * by_s
            self.w = self.w + self.eta * ec * by_w + self.momentum * self.last
            self.last = self.w - before
        change = 0.0 if self.y is None else (y - self.y) / frames
        x = np.clip([-y / SCALE, -change / CHANGE_SCALE], -3, 3)[:, None]
        F = np.exp(-(((x - self.h) / self.s) ** 2)).prod(axis=0)
        G = F / F.sum()
        self.u, self.y = float(G @ self.w), y
        apart = G * (self.w - self.u)
        self.slopes = [apart * 2 * (x - self.h) / self.s**2, apart * 2 * (x - self.h) ** 2 / self.s**3, G]
        return float(np.clip(LIMIT * self.u, -LIMIT, LIMIT))


@pytest.mark.parametrize("scheme", SCHEMES)
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**31), eta=st.floats(0, 0.02), hbar=st.floats(0, 0.5), momentum=st.floats(0, 0.9))
def test_history_is_that_of_the_equations(scheme: str, seed: int, eta: float, hbar: float, momentum: float) -> None:
    """The error of a frame teaches the sample that made the setpoint before it; frames are missed now and then."""
    rng = np.random.default_rng(seed)
    bench = raw("ANFTSC", scheme, spread=0.6, width=1.3, weight=0.8, eta=eta, hbar=hbar, momentum=momentum)
    reference, k = Reference(0.6, 1.3, 0.8, eta, hbar, momentum), 0
    for _ in range(60):
        gap = int(rng.integers(1, 4))
        k += gap
        J, y = rng.normal(), float(rng.normal() * rng.choice([0.003, 0.03]))
        bench.state.jacobian[0, 0, 0] = J * SCALE / LIMIT
        expected = reference.frame(y, gap, J if scheme == "indirect" else SIGN)
        assert bench.frame(k, y) == pytest.approx(expected, abs=1e-10)
        np.testing.assert_allclose(bench.theta, reference.theta, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", VARIANTS)
def test_neuro_fuzzy_setpoint_of_a_zero_signal_is_zero(name: str, scheme: str) -> None:
    """Symmetric rules at rest; what comes first has no change yet."""
    bench = wide(name, scheme)
    assert [bench.frame(k, 0.0) for k in range(3)] == pytest.approx([0] * 3, abs=1e-12)
    assert abs(bench.frame(3, 0.002)) > 1e-4
    first = wide(name, scheme)
    assert abs(first.frame(0, 0.002)) > 1e-4
    assert first.state.learner.x[0].tolist() == [pytest.approx(-0.2), 0.0]


@pytest.mark.parametrize("name", VARIANTS)
def test_at_the_start_some_rule_fires_wherever_the_inputs_may_be(name: str) -> None:
    """Triangles end: theirs fire up to 0.9 of 3."""
    reach = np.linspace(-1, 1, 7) * Bench(controller(name, "direct")).bank.settings["range"][0]
    reach = 0.3 * reach if VARIANTS[name].antecedent == "triangular" else reach
    for error in reach:
        for change in reach:
            bench = Bench(controller(name, "direct"))
            bench.frame(0, float(-error * SCALE + change * CHANGE_SCALE))
            bench.frame(1, float(-error * SCALE))
            assert bench.state.learner.x[0] == pytest.approx([error, change], abs=1e-9)
            assert bench.state.learner.passed.total[0, 0] > FLOOR


def test_inputs_are_scaled_clipped_and_a_change_is_that_of_one_frame() -> None:
    bench = raw(scale=0.02, change_scale=0.005, range=2.0)
    for k, y, expected in (
        (0, 0.01, [-0.5, 0.0]),
        (1, 0.012, [-0.6, -0.4]),
        (4, 0.006, [-0.3, 0.4]),  # 0.006 in three frames
        (5, -0.5, [2.0, 2.0]),
        (6, 0.5, [-2.0, -2.0]),
    ):
        bench.frame(k, y)
        assert bench.state.learner.x[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("rate", "groups"), [("lyapunov", 1), ("lyapunov-groups", 3)])
def test_lyapunov_rates_are_those_of_jacobian_and_penalty(rate: str, groups: int) -> None:
    """Eta / ((J^2 + hbar) |du/df|^2), the norm over all parameters or over h, s and w each."""
    bench, J = raw("ANFTSC", "indirect", rate=rate, eta=0.3, hbar=0.2), 0.7
    reference = Reference(0.5, 1.0, 0.5, 0.0, 0.2, 0.0)
    for k, y in enumerate((0.002, 0.003)):
        bench.state.jacobian[0, 0, 0] = J * SCALE / LIMIT
        squares = [float((slope**2).sum()) for slope in reference.slopes]
        reference.frame(y, 1, J)
        bench.frame(k, y)
    squares = [sum(squares)] * 3 if groups == 1 else squares
    expected = [0.3 / ((J**2 + 0.2) * square + REGULAR) for square in squares]
    np.testing.assert_allclose(bench.state.learner.rate[0, 0], expected, rtol=1e-9)


@pytest.mark.parametrize("profile", ["thesis", "deployed"])
@pytest.mark.parametrize("name", VARIANTS)
def test_without_a_jacobian_nothing_is_learnt(name: str, profile: str) -> None:
    bench = wide(name, "indirect", profile)
    start = bench.theta
    for k in range(20):
        assert bench.frame(k, 0.003) != 0
        assert bench.state.memory.taught[0, 0] == 0
    np.testing.assert_array_equal(bench.theta, start)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", VARIANTS)
def test_output_that_is_not_finite_is_a_setpoint_of_zero(name: str, value: float) -> None:
    """A consequent is lost; whatever is learnt from it later brings no wrong setpoint."""
    bench = wide(name, "direct")
    bench.state.learner.theta[0, -Network(*bench.bank.shape[0]).width] = value
    for k in range(5):
        setpoint, wished_for = bench.frame(k, 0.003), float(bench.state.unlimited[0, 0])
        assert setpoint == (np.clip(wished_for, -LIMIT, LIMIT) if np.isfinite(wished_for) else 0)
        assert setpoint == 0 or not np.isnan(value)


def test_controllers_of_different_networks_do_not_see_each_other() -> None:
    """Their arrays hold the largest of them; a lead-lag stands between."""
    rows = [controller("ANFTSC", "direct"), llc(), controller("ANFFsC", "indirect"), controller("HBsWC", "direct")]
    rng, both, alone = np.random.default_rng(5), Bench(*rows), [Bench(row) for row in rows]
    for bench in (both, alone[2]):
        bench.state.jacobian[2 if bench is both else 0] = 0.02
    for k in range(40):
        entries = [Entry(pmu, 20 * k, 20 * k + 1, rng.normal() * 3e-3) for pmu in PMUS]
        for c, single in enumerate(alone):
            (ours,), (theirs,) = both.give(*entries, controller=c), single.give(*entries)
            assert ours["value"] == theirs["value"]
    assert both.state.memory.taught[:, 0].tolist() == [1, 0, 1, 1]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("name", VARIANTS)
@settings(max_examples=8, deadline=None)
@given(
    frames=st.lists(st.tuples(st.floats(-1e5, 1e5), st.floats(-1e3, 1e3) | st.just(np.nan)), max_size=20),
    eta=st.sampled_from([0.02, 10.0, 1e6]),
)
def test_setpoints_are_within_limits_and_parameters_within_bounds(
    name: str, scheme: str, frames: list[tuple[float, float]], eta: float
) -> None:
    bench = Bench(controller(name, scheme, eta=eta))
    learner = bench.state.learner
    for k, (y, J) in enumerate(frames):
        bench.state.jacobian[0, 0, 0] = J
        assert abs(bench.frame(k, y)) <= LIMIT
        assert np.all((learner.low <= learner.theta) & (learner.theta <= learner.high))
