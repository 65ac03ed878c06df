"""What the tests of learning share: a network that learns at one input, and networks to try."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.compiling import compiled
from facts_damping.neurofuzzy.learning import FIXED, Learners, Rule, infer, learn, learners
from facts_damping.neurofuzzy.network import Network, Pass, backward, by_inputs, forward, network, passes
from tests.neurofuzzy.test_network import PAIRS, output, random_theta, smooth

if TYPE_CHECKING:
    from numpy.typing import NDArray

every_pair = pytest.mark.parametrize(("antecedent", "consequent"), PAIRS)


@compiled
def adapt(
    net: Network, several: Learners, i: int, rule: Rule, error: NDArray[np.float64], curvature: NDArray[np.float64]
) -> None:
    """A pass and a step of adaptation of the i-th of several learners."""
    learner = several.each[i]
    infer(net, learner)
    learn(net, learner, rule, error, curvature)


class Pupil:
    """A network that learns at one input."""

    def __init__(self, net: Network, theta: NDArray[np.float64], x: NDArray[np.float64]) -> None:
        self.net, self.learner = net, learners([net], [theta])
        self.learner.x[0] = x

    @property
    def theta(self) -> NDArray[np.float64]:
        return np.array(self.learner.theta[0])

    @property
    def output(self) -> NDArray[np.float64]:
        return output(self.net, self.theta, self.learner.x[0])

    @property
    def within(self) -> bool:
        return bool(((self.learner.low <= self.learner.theta) & (self.learner.theta <= self.learner.high)).all())

    def step(
        self, rule: Rule, error: float | NDArray[np.float64], curvature: float | NDArray[np.float64] = 1.0
    ) -> None:
        room = np.zeros(self.net.outputs)
        adapt(self.net, self.learner, 0, rule, room + error, room + curvature)

    def pursue(self, rule: Rule, target: NDArray[np.float64] | float) -> float:
        """A step towards a target; the error that is left, of one output."""
        self.step(rule, target - self.output)
        return float((target - self.output)[0])


def rule(
    eta: float = 1.0,
    rate: int = FIXED,
    momentum: float = 0.0,
    leakage: float = 0.0,
    clip: float = 0.0,
    projection: float = 0.0,
) -> Rule:
    """A rule without guards, but for those given."""
    return Rule(float(rate), eta, momentum, leakage, clip, projection)


def looked(net: Network, theta: NDArray[np.float64], x: NDArray[np.float64]) -> Pass:
    """A forward and a backward pass."""
    p = passes(net)
    forward(net, theta, x, p)
    backward(net, p)
    by_inputs(net, theta, p)
    return p


def example(antecedent: str, consequent: str, outputs: int = 1, seed: int = 1) -> Pupil:
    """A network of random parameters at an input where it has no kink."""
    net, rng = network(antecedent, consequent, 2, 2, outputs), np.random.default_rng(seed)
    while True:
        theta, x = random_theta(net, rng), rng.uniform(-0.9, 0.9, 2)
        if smooth(net, theta, x):
            return Pupil(net, theta, x)


def linear(weights: list[float], x: float = 0.5) -> Pupil:
    """One rule, w_0 + w_1 x: linear in its weights, and its membership has no gradient."""
    return Pupil(network("gaussian", "affine", 1, 1, 1), np.array([0.0, 1.0, *weights]), np.array([x]))
