"""Dissipating energy flow: sign and size against the energy balance, and what adds up; cells between PMUs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.errors import InputError
from facts_damping.parameters.plant.pmus import Pmu
from facts_damping_views.analysis.cells import cells
from facts_damping_views.analysis.energy_flow import Phasors, between, energy_flow, strongest
from tests.plant.running import shipped

if TYPE_CHECKING:
    from numpy.typing import NDArray

RATE, OMEGA_0 = 60.0, 2.0 * math.pi * 60.0
T = np.arange(0, 60, 1 / RATE)


class Swing(NamedTuple):
    """Two machines of constant EMF behind a line x: angles over time, and the damping torque of each, p.u. s/rad."""

    angles: NDArray[np.float64]
    damping: tuple[float, float]
    speeds: NDArray[np.complex128]  # rad/s


def swing(frequency: float) -> Swing:
    """The forced response of the linear equations: machine 1 is driven, both are damped."""
    x, delta, inertia, damping = 0.5, 0.4, (12.0 / OMEGA_0, 8.0 / OMEGA_0), (0.004, 0.02)
    stiffness = math.cos(delta) / x
    s = 2j * math.pi * frequency
    alone = np.diag([inertia[i] * s * s + damping[i] * s for i in range(2)])
    matrix = alone + stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]])
    phasor = np.linalg.solve(matrix, [1e-3, 0.0])
    moving = (phasor[None, :] * np.exp(s * T)[:, None]).real
    return Swing(np.array([delta, 0.0]) + moving, damping, np.asarray(s * phasor, np.complex128))


def measured(angles: NDArray[np.float64]) -> Phasors:
    """Both machines' terminals."""
    voltage = np.exp(1j * angles)
    current = (voltage - voltage[:, ::-1]) / 0.5j
    return Phasors(np.repeat(T[:, None], 2, axis=1), voltage, current)


@pytest.mark.parametrize("frequency", [0.4, 1.3])
def test_flow_is_what_the_other_machine_damps(frequency: float) -> None:
    """D |speed|^2 / 2 flows out of the driven machine into the other one, whatever the machines' own damping is."""
    case = swing(frequency)
    turned = case.angles + 2 * math.pi * 0.03 * T[:, None]  # the grid at 60.03 Hz
    flow = energy_flow(measured(turned), frequency).flow.mean(axis=0)
    damped = 0.5 * case.damping[1] * abs(case.speeds[1]) ** 2
    np.testing.assert_allclose(flow, [damped, -damped], rtol=2e-3)


def test_missing_frames_and_a_drift_change_little() -> None:
    case = swing(0.4)
    whole = energy_flow(measured(case.angles), 0.4).flow.mean(axis=0)
    some = measured(case.angles + 0.01 * (T[:, None] / 60.0) ** 2)
    lost = np.random.default_rng(1).random(some.voltage.shape) < 0.1
    some.voltage[lost] = np.nan
    np.testing.assert_allclose(energy_flow(some, 0.4).flow.mean(axis=0), whole, rtol=0.02)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 10**6), branches=st.integers(2, 5))
def test_flows_at_a_bus_add_up_to_zero(seed: int, branches: int) -> None:
    """Currents of any size and phase that add up to zero, at one voltage."""
    draw = np.random.default_rng(seed)
    wave = np.exp(2j * math.pi * 0.7 * T)
    voltage = np.exp(1e-2 * (draw.normal() * wave.real + 1j * draw.normal() * wave.imag))
    size = draw.normal(size=(2, branches)) + 1j * draw.normal(size=(2, branches))
    current = size[0] + 0.05 * (size[1] * wave[:, None]).real
    current[:, -1] = -current[:, :-1].sum(axis=1)
    times, volts = (np.repeat(a[:, None], branches, axis=1) for a in (T, voltage))
    flow = energy_flow(Phasors(times, volts, current), 0.7).flow
    np.testing.assert_allclose(flow.sum(axis=1), 0.0, atol=1e-12 * np.abs(flow).max() + 1e-15)


def test_frequency_is_that_of_the_strongest_line() -> None:
    assert strongest(measured(swing(0.437).angles), RATE) == pytest.approx(0.437, abs=1e-3)


def test_bad_input() -> None:
    still = measured(np.zeros((len(T), 2)))
    with pytest.raises(InputError, match=r"no oscillation between 0\.1 and 5 Hz"):
        strongest(still, RATE)
    with pytest.raises(InputError, match=r"10\.0 s given; allowed: at least 20\.0 s, 8 periods at 0\.4 Hz"):
        energy_flow(between(measured(swing(0.4).angles), 5.0, 15.0), 0.4)


def test_cells_between_pmus() -> None:
    """A machine with a PMU is a cell; a tie divides the rest by area; both ends of a line leave it as a cell."""
    system = shipped("two_area")
    grid = cells(system, [True] * 5)
    assert [c.units for c in grid.cells if c.units] == [["G1"], ["G2"], ["G3"], ["G4"]]
    rest = {tuple(c.loads): c.areas for c in grid.cells if c.loads}
    assert rest == {("load_1",): ["area_1"], ("load_2",): ["area_2"]}
    np.testing.assert_array_equal(grid.balance.sum(axis=0), 0.0)
    west = next(k for k, c in enumerate(grid.cells) if c.loads == ["load_1"])
    np.testing.assert_array_equal(grid.balance[west], [-1, -1, 0, 0, 1])
    blind = cells(system, [True, True, False, True, True])
    assert next(c for c in blind.cells if "G3" in c.units).areas == ["area_2"]
    ends = [Pmu(name="a", bus="B5", branches=["line_5_6"]), Pmu(name="b", bus="B6", branches=["line_5_6", "line_6_7"])]
    grid = cells(system.model_copy(update={"pmus": ends}), [True, True])
    assert [c.units for c in grid.cells] == [["G1"], ["G2"], ["G3", "G4"]]
