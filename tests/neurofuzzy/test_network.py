"""Every antecedent with every consequent: gradients, counts, bounds; what the tables promise."""

from __future__ import annotations

import itertools
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import make_interp_spline

from facts_damping.neurofuzzy.antecedent import POINTS, gaussian, nearest_point, spline
from facts_damping.neurofuzzy.consequent import WAVELETS, basis
from facts_damping.neurofuzzy.network import FLOOR, Network, backward, by_inputs, counted, forward, network, passes
from facts_damping.neurofuzzy.table import ANTECEDENTS, CONSEQUENTS, VARIANTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

PAIRS = list(itertools.product(ANTECEDENTS, CONSEQUENTS))
SHAPES = [(2, 2, 1), (3, 2, 2), (4, 3, 2)]  # inputs, rules, outputs
TABLE_3_1 = {  # parameters updated with two inputs and two rules
    "ANFTSC": 10,
    "ANFSC": 12,
    "ANFFsC": 58,
    "ANFGuMeC": 18,
    "ANFGuMoC": 18,
    "ANFTrMeC": 18,
    "ANFTrMoC": 18,
    "ANFLeC": 24,
    "ANFLeWC": 20,
    "ANFBsC": 6,
    "HBsWC": 14,
}


def random_theta(net: Network, rng: np.random.Generator) -> NDArray[np.float64]:
    """Parameters within their bounds: centres h, widths s, degrees of splines, volumes and dilations positive."""
    theta = rng.uniform(-1, 1, net.size)
    first = net.inputs * net.rules * net.stored
    members = theta[:first].reshape(-1, net.stored)
    if net.stored == POINTS:
        members[:] = rng.uniform(0.05, 1, members.shape)
    else:
        members[:, 0] = rng.uniform(-0.8, 0.8, len(members))
        members[:, 1] = rng.uniform(2.5, 4, len(members))
    rules, kind = theta[first:].reshape(-1, net.width), list(CONSEQUENTS)[net.consequent_row]
    if kind == "sam":
        rules[:, 1] = rng.uniform(0.3, 2, len(rules))
    if kind in ("mexican-hat", "morlet"):
        rules[:, 2::2] = rng.uniform(0.5, 2, rules[:, 2::2].shape) * rng.choice([-1, 1], rules[:, 2::2].shape)
    return theta


def output(net: Network, theta: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float64]:
    p = passes(net)
    forward(net, theta, x, p)
    return np.array(p.output)


def at_parameters(net: Network, x: NDArray[np.float64], theta: NDArray[np.float64]) -> NDArray[np.float64]:
    return output(net, theta, x)


def differences(f: Callable[[Any], Any], at: NDArray[np.float64]) -> NDArray[np.float64]:
    """Central differences of fourth order, a column an argument."""
    step, columns = 2e-4, []
    for i in range(len(at)):
        low, down, up, high = (f(at + k * step * np.eye(len(at))[i]) for k in (-2, -1, 1, 2))
        columns.append((low - 8 * down + 8 * up - high) / (12 * step))
    return np.asarray(np.array(columns).T)


def smooth(net: Network, theta: NDArray[np.float64], x: NDArray[np.float64]) -> bool:
    """Whether no kink lies within the differences: corners of triangles and splines, halves of the wavelets."""
    if net.stored == POINTS and np.any(np.abs((x + 1) * (POINTS - 1) % 1) < 0.02):
        return False
    p = passes(net)
    forward(net, theta, x, p)
    near_half = np.any(np.abs(p.firing - 0.5) < 0.01)
    centres = theta[: net.inputs * net.rules * net.stored].reshape(net.inputs, net.rules, net.stored)[..., 0]
    near_top = list(ANTECEDENTS)[net.antecedent_row] == "triangular" and np.any(np.abs(x[:, None] - centres) < 0.01)
    return not near_half and not near_top


@pytest.mark.parametrize(("pair", "shape"), list(zip(PAIRS, itertools.cycle(SHAPES), strict=False)), ids=str)
def test_gradients_are_central_differences(pair: tuple[str, str], shape: tuple[int, int, int]) -> None:
    """Every antecedent with every consequent, and each of them in every shape."""
    antecedent, consequent = pair
    if consequent == "fourier":
        shape = (min(shape[0], 2), *shape[1:])  # 5^m terms a rule: with more inputs the differences take minutes
    net = network(antecedent, consequent, *shape)
    rng = np.random.default_rng(7)
    checked = 0
    while checked < 2:
        theta, x = random_theta(net, rng), rng.uniform(-0.95, 0.95, net.inputs)
        if not smooth(net, theta, x):
            continue
        p = passes(net)
        forward(net, theta, x, p)
        backward(net, p)
        by_inputs(net, theta, p)
        assert p.total.min() > FLOOR
        scale = max(1.0, np.abs(p.by_theta).max())
        by_theta = differences(partial(at_parameters, net, x), theta)
        np.testing.assert_allclose(p.by_theta, by_theta, rtol=1e-6, atol=1e-6 * scale * 0.1)
        by_input = differences(partial(output, net, theta), x)
        np.testing.assert_allclose(p.by_input, by_input, rtol=1e-6, atol=1e-7 * max(1.0, np.abs(by_input).max()))
        assert np.abs(p.by_theta).max() > 1e-3
        checked += 1


@pytest.mark.parametrize("name", VARIANTS)
def test_parameter_counts_are_those_of_table_3_1(name: str) -> None:
    variant = VARIANTS[name]
    assert counted(variant.antecedent, variant.consequent, 2, 2, 1) == TABLE_3_1[name]


@pytest.mark.parametrize(("antecedent", "consequent"), PAIRS)
@settings(max_examples=10, deadline=None)
@given(x=st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=2), seed=st.integers(0, 2**31))
def test_output_and_gradients_are_finite_for_any_input(
    antecedent: str, consequent: str, x: list[float], seed: int
) -> None:
    net = network(antecedent, consequent, 2, 2, 1)
    theta, p = random_theta(net, np.random.default_rng(seed)), passes(net)
    forward(net, theta, np.array(x), p)
    backward(net, p)
    by_inputs(net, theta, p)
    assert all(np.isfinite(array).all() for array in (p.firing, p.output, p.by_theta, p.by_input))
    assert ((p.mu >= 0) & (p.mu <= 1)).all()


def test_network_without_firing_rules_gives_zero_and_learns_nothing() -> None:
    net = network("triangular", "singleton", 2, 2, 1)
    theta, p = random_theta(net, np.random.default_rng(1)), passes(net)
    forward(net, theta, np.array([50.0, -50.0]), p)
    backward(net, p)
    by_inputs(net, theta, p)
    assert p.output == 0
    assert not p.by_theta.any()
    assert not p.by_input.any()


@given(x=st.floats(-3, 3))
def test_splines_are_a_partition_of_unity(x: float) -> None:
    for function in (spline, nearest_point):
        fractions = np.zeros(POINTS)
        value, _ = function(np.ones(POINTS), x, fractions)
        assert value == pytest.approx(1.0, abs=1e-15)
        assert fractions.sum() == pytest.approx(1.0, abs=1e-15)
        assert (fractions >= 0).all()


def test_interpolated_spline_is_scipys() -> None:
    rng = np.random.default_rng(3)
    degrees, x = rng.uniform(0, 1, POINTS), rng.uniform(-1, 1, 100)
    curve = make_interp_spline(np.linspace(-1, 1, POINTS), degrees, k=1)
    degrees_found = [spline(degrees, point, np.zeros(POINTS))[0] for point in x]
    np.testing.assert_allclose(degrees_found, curve(x), rtol=0, atol=1e-14)


def test_legendre_wavelets_are_orthonormal() -> None:
    def product(a: int, b: int) -> float:
        return float(sum(quad(lambda f: basis(a, f)[0] * basis(b, f)[0], *half)[0] for half in ((0, 0.5), (0.5, 1))))

    gram = [[product(a, b) for b in range(WAVELETS)] for a in range(WAVELETS)]
    np.testing.assert_allclose(gram, np.eye(WAVELETS), rtol=0, atol=1e-7)
    assert basis(1, 1.0)[0] == pytest.approx(np.sqrt(2))


def test_gaussian_of_the_thesis() -> None:
    """(3.9): exp(-((x - h) / s)^2), no half."""
    assert gaussian(np.array([0.25, 2.0]), 1.25, np.zeros(2))[0] == pytest.approx(np.exp(-0.25))
