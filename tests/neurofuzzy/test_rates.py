"""Lyapunov learning rates: what is left of an error after a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.neurofuzzy.learning import LYAPUNOV, LYAPUNOV_GROUPS, REGULAR
from facts_damping.neurofuzzy.network import network
from facts_damping.neurofuzzy.start import Start, groups, initial
from tests.neurofuzzy.pupil import Pupil, every_pair, example, linear, looked, rule

if TYPE_CHECKING:
    from numpy.typing import NDArray


@pytest.mark.parametrize("eta", [0.3, 1.0, 1.9, 2.1])
def test_joint_rate_of_a_linear_network_is_exact(eta: float) -> None:
    """Each step leaves 1 - eta of the error, but for the regular denominator: it falls for eta below 2 only."""
    pupil, square = linear([0.1, 0.2]), 1 + 0.5**2
    errors = [pupil.pursue(rule(eta, LYAPUNOV), 0.7) for _ in range(12)]
    factor = 1 - eta * square / (square + REGULAR)
    np.testing.assert_allclose(errors, (0.7 - 0.2) * factor ** np.arange(1, 13), rtol=1e-9, atol=1e-15)
    assert (abs(errors[-1]) < abs(errors[0])) == (eta < 2)


def squares(pupil: Pupil) -> NDArray[np.float64]:
    """Squared norms of the gradient's groups."""
    gradient = looked(pupil.net, pupil.theta, pupil.learner.x[0]).by_theta[0]
    return np.bincount(pupil.learner.group[0], gradient**2).astype(float)


@every_pair
@pytest.mark.parametrize(("rate", "eta"), [(LYAPUNOV, 0.5), (LYAPUNOV, 1.0), (LYAPUNOV, 1.9), (LYAPUNOV_GROUPS, 1.0)])
def test_factor_of_small_errors(antecedent: str, consequent: str, rate: int, eta: float) -> None:
    """To first order 1 - eta with one joint rate, and 1 - G with one rate for each of G groups: -2 for three."""
    tried, small = (example(antecedent, consequent, seed=seed) for seed in range(50)), 1e-9
    pupil = next(pupil for pupil in tried if squares(pupil).min() > 1e3 * REGULAR)
    count = len(groups(pupil.net)) if rate == LYAPUNOV_GROUPS else 1
    left = pupil.pursue(rule(eta, rate), pupil.output + small) / small
    assert left == pytest.approx(1 - eta * count, abs=0.01)


def test_rates_of_groups_diverge_where_the_joint_one_converges() -> None:
    """Four groups: h, s, c, V."""
    joint, apart = example("gaussian", "sam"), example("gaussian", "sam")
    target = joint.output + 1e-6
    for _ in range(6):
        near, far = joint.pursue(rule(1.0, LYAPUNOV), target), apart.pursue(rule(1.0, LYAPUNOV_GROUPS), target)
    assert abs(near) < 1e-12
    assert abs(far) > 1e-6 * 2.5**6


@pytest.mark.parametrize("eta", [0.5, 1.0, 1.9])
@pytest.mark.parametrize("antecedent", ["gaussian", "b-spline-interpolated"])
def test_joint_bound_of_shared_antecedents(antecedent: str, eta: float) -> None:
    """Two outputs of nearly the same large weights: nearly all of their gradients is shared.

    Errors e = y - M u of three quantities y (a penalty on effort is one), ec = M' e; each output by its own bound
    would let them grow.
    """
    net = network(antecedent, "singleton", 2, 2, 2)
    theta = initial(net, Start([5.0] * net.outputs, [0.5, 0.5], [1.0, 1.0], [0.0, 0.0], [1.0, 1.0]))
    pupil, M = Pupil(net, theta, np.array([0.1, -0.05])), np.array([[1.0, 0.9], [0.5, 0.6], [0.3, 0.3]])
    gradient = looked(net, theta, pupil.learner.x[0]).by_theta
    curvature = (M**2).sum(axis=0)
    rates = eta / (curvature * (gradient**2).sum(axis=1))
    alone = np.eye(3) - M @ gradient @ gradient.T @ np.diag(rates) @ M.T
    target = M @ pupil.output + 1e-7 * np.ones(3)
    sizes = []
    for _ in range(20):
        error = target - M @ pupil.output
        sizes.append(np.linalg.norm(error))
        pupil.step(rule(eta, LYAPUNOV), M.T @ error, curvature)
    assert np.all(np.diff(sizes) < 1e-12)
    assert sizes[-1] < 0.5 * sizes[0]
    assert np.abs(np.linalg.eigvals(alone)).max() > 1 or eta < 1


@pytest.mark.parametrize("rate", [LYAPUNOV, LYAPUNOV_GROUPS])
def test_vanishing_gradient_gives_no_jump(rate: int) -> None:
    """Its step is at most that of the gradient sqrt(REGULAR); without any gradient there is none."""
    for slope in [0.0, *10.0 ** np.arange(-12, 1)]:
        pupil = linear([0.1, 0.2])
        before = pupil.theta
        pupil.step(rule(1.0, rate), slope * 1.0, slope**2)
        moved = np.linalg.norm(pupil.theta - before)
        assert moved <= 0.5 / np.sqrt(REGULAR)
        assert moved <= 2 * slope / REGULAR
    deaf = Pupil(network("triangular", "singleton", 1, 2, 1), np.array([0.0, 1.0, 0.0, 1.0, 0.3, 0.4]), np.array([2.0]))
    before = deaf.theta
    deaf.step(rule(1.0, rate), 1e6)
    np.testing.assert_array_equal(deaf.theta, before)
