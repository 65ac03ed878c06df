"""The SVC: its susceptance, its regulator against analytic solutions, limits, blocking."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq

from facts_damping.small_signal.linearisation import linearise
from tests.plant.channels import ACTIVE, ANGLE, REACTIVE, VOLTAGE
from tests.plant.running import changed, follow, frame_times, moved, plant, shipped, slopes
from tests.plant.small import SPUR, between_infinite_buses
from tests.plant.test_properties import everywhere

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built
    from tests.plant.running import Trace

AT_ONCE = 1000.0  # p.u./s


def row(bus: str = "S", **fields: Any) -> dict[str, Any]:
    limits = {"setpoint_max": 0.1, "rate_max": AT_ONCE, "B_max": 4.0, "B_min": -3.0}
    return {"name": "svc", "kind": "svc", "bus": bus, **limits, "K": 20.0, **fields}


def small(bus: str = "S", **fields: Any) -> Built:
    """An SVC at the end of a lossless line from an infinite bus (S), or at that bus itself (A)."""
    return plant(between_infinite_buses([row(bus, **fields)], step=1e-3), installed=["svc"])


def susceptance(built: Built, trace: Trace) -> NDArray[np.float64]:
    return np.asarray(trace.x[:, built.state_names.index("svc.B")])


def two_area(**fields: Any) -> System:
    """The two areas with an SVC in the tie, and a PMU at each end of each branch."""
    system = shipped("two_area")
    devices = [*(d.model_dump(by_alias=True) for d in system.devices), row("B8W", **fields)]
    return everywhere(changed(system, devices=devices))


@settings(deadline=None, max_examples=60)
@given(B=st.floats(-5, 5), V=st.floats(0.8, 1.2))
def test_svc_is_a_susceptance(B: float, V: float) -> None:
    """Behind a reactance X: V = E / (1 - X B), in phase; it gives Q = B V^2, no power, and |i| = |B| V."""
    built = plant(between_infinite_buses([row()], V=V), installed=["svc"])
    trace = follow(built, [0.0], x=moved(built, {"svc.B": B}))
    frame, device = trace.frames[0, 2], trace.devices[0, 0]
    voltage = V / (1 - SPUR * B)
    assert (frame[VOLTAGE], frame[ANGLE]) == pytest.approx((voltage, np.deg2rad(30)), abs=1e-11)
    assert device["reactive_power"] == pytest.approx(B * voltage**2, abs=1e-10)
    assert device["active_power"] == pytest.approx(0.0, abs=1e-12)
    assert device["current"] == pytest.approx(abs(B) * voltage, abs=1e-11)
    assert frame[REACTIVE] == pytest.approx(B * voltage**2, abs=1e-10)  # out of its bus, into the line
    assert np.isnan([device[name] for name in ("injected_voltage", "active_voltage", "dc_voltage")]).all()


@pytest.mark.parametrize("T", [0.02, 0.05, 0.3])
@pytest.mark.parametrize("u", [0.05, -0.04])
def test_at_a_stiff_bus_the_susceptance_follows_in_its_time(T: float, u: float) -> None:
    """B = K u (1 - exp(-t / T)), as the voltage does not answer; the ramp of the setpoint takes 0.05 ms."""
    built = small("A", T=T)
    trace = follow(built, np.linspace(0, 5 * T, 40), [(0.0, u)])
    ramp = abs(u) / AT_ONCE
    late = trace.t > ramp
    # A ramp of length r to u answers as a step at r / 2 but for (r / T)^2 / 24.
    expected = 20.0 * u * (1 - np.exp(-(trace.t - ramp / 2) / T))
    np.testing.assert_allclose(susceptance(built, trace)[late], expected[late], rtol=0, atol=2e-6)


@pytest.mark.parametrize(("bus", "X"), [("A", 0.0), ("S", SPUR)])
def test_its_eigenvalue_is_that_of_the_loop_through_its_bus(bus: str, X: float) -> None:
    """dV/dB = X E at B = 0, so T dB = K u - (1 + K X E) B: eigenvalue -(1 + K X) / T, gain K / T."""
    built = small(bus, T=0.1, K=40.0)
    A, B = linearise(built)
    at = built.state_names.index("svc.B")
    assert A[at, at] == pytest.approx(-(1 + 40.0 * X) / 0.1, rel=1e-7)
    assert B[at, 0] == pytest.approx(40.0 / 0.1, rel=1e-7)
    assert np.abs(np.delete(A[at], at)).max() < 1e-6  # what hangs on an infinite bus is not felt beside it


@pytest.mark.parametrize("u", [0.08, 0.02, -0.03, -0.09])
def test_at_rest_regulator_and_network_meet(u: float) -> None:
    """B = K (1 + u - V) with V = 1 / (1 - X B)."""
    built = small()
    trace = follow(built, [0.0, 2.0], [(0.0, u)])
    B = brentq(lambda B: 20.0 * (1 + u - 1 / (1 - SPUR * B)) - B, -2.9, 3.9, xtol=1e-14)
    assert susceptance(built, trace)[-1] == pytest.approx(B, abs=1e-8)
    assert np.sign(trace.frames[-1, 2, VOLTAGE] - 1) == np.sign(u)


@pytest.mark.parametrize(("u", "limit"), [(0.1, 1.2), (-0.1, -0.7)])
def test_susceptance_stays_within_its_limits_and_leaves_them_without_wind_up(u: float, limit: float) -> None:
    """At a stiff bus K u = 2 is asked for; after the setpoint's end it falls at once, as exp(-t / T)."""
    built = small("A", B_max=1.2, B_min=-0.7)
    trace = follow(built, frame_times(3, 200), [(0.0, u), (2.0, 0.0)])
    B = susceptance(built, trace)
    assert np.abs(B).max() <= abs(limit) * (1 + 1e-9)
    assert B[trace.t < 2][-1] == pytest.approx(limit, abs=1e-6)
    after = trace.t > 2.01
    expected = limit * np.exp(-(trace.t[after] - 2.0 - 0.5 * abs(u) / AT_ONCE) / 0.05)
    # The order leaves its limit within the ramp of 0.1 ms: somewhat later than in its middle.
    np.testing.assert_allclose(B[after], expected, rtol=1e-3, atol=1e-9)


def test_svc_starts_at_rest_and_leaves_the_power_flow_unchanged() -> None:
    built = plant(two_area(), installed=["sssc", "svc"])
    assert np.abs(slopes(built)).max() < 1e-9
    np.testing.assert_array_equal(built.flow.voltage, plant("two_area").flow.voltage)


def test_reactive_power_of_the_svc_goes_into_the_branches_at_its_bus() -> None:
    """Of the two areas, while machines swing: no power, Q = B V^2."""
    system = two_area()
    step = {"time": 0.0, "kind": "load_step", "load": "load_2", "change": -0.1}
    built = plant(system, step, installed=["svc"])
    trace = follow(built, frame_times(2), [(0.1, 0.05), (1.0, -0.04)])
    names = [s.name for s in system.pmus]
    at = [names.index(name) for name in ("line_1.to", "line_2.to", "sssc.from")]
    out = (trace.frames[:, at, ACTIVE] + 1j * trace.frames[:, at, REACTIVE]).sum(axis=1)
    B = susceptance(built, trace)
    assert np.ptp(B) > 0.5
    np.testing.assert_allclose(out, 1j * B * trace.frames[:, at[0], VOLTAGE] ** 2, rtol=0, atol=1e-10)


def test_fault_at_its_bus_blocks_it_and_it_comes_back() -> None:
    """No current and no state moving while the voltage is too low; afterwards it lifts the voltage again."""
    fault = {"time": 0.2, "kind": "fault", "bus": "B8W", "duration": 0.1}
    built = plant(two_area(), fault, installed=["svc"])
    trace = follow(built, frame_times(1, 240), [(0.05, 0.02)])
    burning = (trace.t >= 0.2) & (trace.t < 0.3)
    device, B = trace.devices[:, 0], susceptance(built, trace)
    np.testing.assert_array_equal(device["blocked"], burning)
    assert (device["current"][burning] == 0).all()
    assert np.ptp(B[burning]) == 0
    assert (device["reactive_power"][trace.t < 0.2][-1], device["reactive_power"][trace.t > 0.31].max()) > (0.1, 0.1)
    assert trace.sound.all()
