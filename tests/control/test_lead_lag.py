"""The lead-lag's step against SciPy's discrete and continuous transfer functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, dlsim, freqs, lsim

from facts_damping.control.lead_lag import step
from facts_damping.control.parameter_tables import LEAD_LAG_PARAMETERS
from facts_damping.control.table import CONTROLLERS
from facts_damping.parameters.run import Controller
from tests.control.bench import settings_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

some = settings(deadline=None, max_examples=40)


def row(**parameters: float | str | list[float]) -> Any:
    """A record of settings: the thesis's parameters, but for those given."""
    return settings_of(Controller(parameters=parameters))[0]


ROW = row()


def transfer(p: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Numerator and denominator of kG s Tw / (1 + s Tw) (1 + s T1) / (1 + s T2) (1 + s T3) / (1 + s T4)."""
    above = np.polymul([p["gain"] * p["Tw"], 0.0], np.polymul([p["T1"], 1.0], [p["T3"], 1.0]))
    return above, np.polymul([p["Tw"], 1.0], np.polymul([p["T2"], 1.0], [p["T4"], 1.0]))


def respond(p: Any, inputs: NDArray[np.float64], dt: NDArray[np.float64] | float) -> list[float]:
    """Outputs at each input; `dt` before each but the first."""
    state = np.zeros(CONTROLLERS["LLC"].states)
    steps = np.broadcast_to(dt, len(inputs) - 1)
    return [
        step(p, state, float(inputs[0]), 0.0),
        *(step(p, state, *pair) for pair in zip(inputs[1:], steps, strict=True)),
    ]


def test_parameters_are_those_of_the_thesis() -> None:
    """Appendix B; those of other kinds of controllers are not set."""
    names = ["gain", "Tw", "T1", "T2", "T3", "T4"]
    assert [ROW[name] for name in names] == [10.0, 10.0, 0.0761, 0.3, 0.4272, 0.3]
    assert [row(T4=0.5, gain=3.0)[name] for name in names] == [3.0, 10.0, 0.0761, 0.3, 0.4272, 0.5]
    assert not any(ROW[name] for name in ROW.dtype.names if name not in LEAD_LAG_PARAMETERS)


positive = st.floats(0.02, 20)


@some
@given(
    gain=st.floats(0.1, 100),
    times=st.lists(positive, min_size=5, max_size=5),
    dt=st.sampled_from([1 / 240, 1 / 60, 1 / 25]),
    seed=st.integers(0, 1000),
)
def test_step_is_the_bilinear_transform(gain: float, times: list[float], dt: float, seed: int) -> None:
    """SciPy's cont2discrete of the whole transfer function, driven from rest at the first frame."""
    p = row(gain=gain, **dict(zip(("Tw", "T1", "T2", "T3", "T4"), times, strict=True)))
    inputs = np.r_[0.0, np.random.default_rng(seed).normal(size=80)]
    discrete = cont2discrete(transfer(p), dt, "bilinear")
    (expected,) = dlsim((discrete[0][0], discrete[1], dt), inputs)[1].T
    scale = 1 + np.abs(expected).max()
    np.testing.assert_allclose(respond(p, inputs, dt), expected, rtol=0, atol=1e-7 * scale)


@pytest.mark.parametrize("hertz", [0.1, 0.63, 1.2])
def test_low_frequencies_pass_as_through_the_continuous_function(hertz: float) -> None:
    """Gain and phase at 60 frames/s: the transform bends the frequency by (w dt)^2 / 12, 0.13 % at 1.2 Hz."""
    dt, seconds = 1 / 60, 200
    t = np.arange(seconds * 60) * dt
    outputs = np.array(respond(ROW, np.sin(2 * np.pi * hertz * t), dt))
    settled = t >= seconds - 10 / min(hertz, 1.0)
    design = np.c_[np.sin(2 * np.pi * hertz * t[settled]), np.cos(2 * np.pi * hertz * t[settled])]
    gain = complex(*np.linalg.lstsq(design, outputs[settled])[0])
    (expected,) = freqs(*transfer(ROW), worN=[2 * np.pi * hertz])[1]
    assert gain == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("seed", range(4))
def test_steps_of_any_length_follow_the_continuous_function(seed: int) -> None:
    """Frames that come irregularly, 2 to 20 ms apart: as SciPy's lsim of the same piecewise-linear input."""
    dt = np.random.default_rng(seed).uniform(0.002, 0.02, 400)
    t = np.r_[0.0, np.cumsum(dt)]
    inputs = np.sin(4 * t) - 0.3 * np.sin(9 * t)
    fine = np.linspace(0, t[-1], 20_001)
    _, expected, _ = lsim(transfer(ROW), np.interp(fine, t, inputs), fine)
    outputs = respond(ROW, inputs, dt)
    np.testing.assert_allclose(outputs, np.interp(t, fine, expected), rtol=0, atol=2e-3 * np.abs(expected).max())


@some
@given(first=st.floats(-1e3, 1e3), before=st.lists(st.floats(-10, 10), min_size=6, max_size=6))
def test_first_frame_gives_nothing_and_starts_at_rest(first: float, before: list[float]) -> None:
    """Whatever the state held; a constant input then gives nothing either: the washout."""
    state = np.array(before)
    assert step(ROW, state, first, 0.0) == 0
    assert [step(ROW, state, first, 0.02) for _ in range(5)] == pytest.approx([0] * 5, abs=1e-9 * (1 + abs(first)))


def test_step_of_the_input_decays_with_the_washout() -> None:
    """After 100 s of Tw = 10 s, exp(-10) of gain T1 T3 / (T2 T4) and what the sections add."""
    outputs = respond(ROW, np.r_[0.0, np.ones(6000)], 1 / 60)
    assert outputs[1] == pytest.approx(10 * 0.0761 * 0.4272 / 0.09, rel=0.1)
    assert outputs[-1] == pytest.approx(10 * np.exp(-10), rel=0.15)


@some
@given(a=st.floats(-5, 5), b=st.floats(-5, 5), seed=st.integers(0, 1000))
def test_superposition_holds(a: float, b: float, seed: int) -> None:
    first, two = np.random.default_rng(seed).normal(size=(2, 50))
    both = respond(ROW, a * first + b * two, 1 / 60)
    apart = a * np.array(respond(ROW, first, 1 / 60)) + b * np.array(respond(ROW, two, 1 / 60))
    np.testing.assert_allclose(both, apart, rtol=0, atol=1e-10)
