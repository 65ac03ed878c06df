"""Where networks start: symmetric rules, within their bounds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from facts_damping.control.parameter_tables import NEURO_FUZZY_PARAMETERS
from facts_damping.neurofuzzy.antecedent import POINTS
from facts_damping.neurofuzzy.network import network
from facts_damping.neurofuzzy.start import Start, initial
from facts_damping.neurofuzzy.table import NU, H, S, Slot, W
from tests.neurofuzzy.pupil import Pupil, every_pair, looked
from tests.neurofuzzy.test_network import output

if TYPE_CHECKING:
    from numpy.typing import NDArray


def declared(name: str) -> st.SearchStrategy[float]:
    """Numbers within a parameter's range."""
    parameter = NEURO_FUZZY_PARAMETERS[name]
    return st.floats(parameter.low, parameter.high)


@st.composite
def starts(draw: st.DrawFn) -> Start:
    """Start numbers for two inputs, in the ranges that users may give; shifts beyond their bounds, too."""
    spread, width, dilation, shift = (
        draw(st.lists(numbers, min_size=2, max_size=2))
        for numbers in (declared("spread"), declared("width"), declared("dilation"), st.floats(-10, 10))
    )
    return Start([draw(declared("weight"))] * 3, spread, width, shift, dilation)


inputs = st.lists(st.floats(-3, 3), min_size=2, max_size=2).map(np.array)


@every_pair
@settings(max_examples=12, deadline=None)
@given(start=starts(), x=inputs, rules=st.sampled_from([2, 3]))
def test_symmetric_rules_are_odd_and_start_within_bounds(
    antecedent: str, consequent: str, start: Start, x: NDArray[np.float64], rules: int
) -> None:
    if antecedent == "b-spline":  # half way between two control points the lower one is taken, on both sides
        assume(np.all(np.abs((x + 1) * (POINTS - 1) / 2 % 1 - 0.5) > 1e-6))
    net = network(antecedent, consequent, 2, rules, 1)
    theta = initial(net, start)
    assert Pupil(net, theta, x).within
    assert output(net, theta, np.zeros(2)) == pytest.approx(0, abs=1e-12)
    assert output(net, theta, x) == pytest.approx(-output(net, theta, -x), abs=1e-12)


@every_pair
def test_symmetric_rules_answer(antecedent: str, consequent: str) -> None:
    """What is odd by being zero everywhere would not do."""
    start = Start([0.5], [0.5, 0.5], [2.0, 2.0], [0.3, -0.2], [1.0, 1.0])
    net = network(antecedent, consequent, 2, 2, 1)
    assert abs(output(net, initial(net, start), np.array([0.4, 0.3]))) > 1e-3


@pytest.mark.parametrize(("name", "slot"), [("weight", W), ("spread", H), ("width", S), ("dilation", NU)])
def test_starts_that_users_may_give_are_within_the_bounds_of_learning(name: str, slot: Slot) -> None:
    parameter = NEURO_FUZZY_PARAMETERS[name]
    assert slot.low <= parameter.low < parameter.high <= slot.high


@pytest.mark.parametrize("antecedent", ["b-spline", "b-spline-interpolated"])
def test_degrees_of_a_spline_start_as_those_of_a_gaussian(antecedent: str) -> None:
    """At its control points, but for the lowest degree allowed."""
    start = Start([0.5], [0.5, 0.9], [1.0, 0.6], [0.0, 0.0], [1.0, 1.0])
    nets = [network(kind, "singleton", 2, 2, 1) for kind in (antecedent, "gaussian")]
    for point in np.linspace(-1, 1, POINTS):
        degrees, expected = (looked(net, initial(net, start), np.full(2, point)).mu for net in nets)
        np.testing.assert_allclose(degrees, np.maximum(expected, 0.01), rtol=1e-12)
