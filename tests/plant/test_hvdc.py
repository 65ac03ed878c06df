"""The HVDC link: powers and voltages in closed form, its modulation against the swing equation, service, limits."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_validation.devices import SWINGS, two_machines
from tests.plant.channels import ACTIVE, REACTIVE, VOLTAGE
from tests.plant.running import changed, follow, frame_times, plant, shipped
from tests.plant.small import SPUR, between_infinite_buses

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

AT_B, AT_S = 1, 2  # PMUs
FAULT = {"time": 0.1, "kind": "fault", "bus": "S", "x": 0.02, "duration": 0.2}


def row(**fields: Any) -> dict[str, Any]:
    """A link of 100 MW from S, at the end of a reactance, to an infinite bus."""
    defaults = {"name": "hvdc", "kind": "hvdc", "from": "S", "to": "B", "P": 100.0, "P_max": 1000.0}
    return {**defaults, "setpoint_max": 0.5, "rate_max": 10.0, **fields}


def link(**fields: Any) -> System:
    return between_infinite_buses([row(**fields)], step=1e-3)


def tangent(pf: float) -> float:
    return float(np.tan(np.arccos(pf)))


def at_constant_power(P: float, Q: float, X: float = SPUR) -> float:
    """Voltage behind a reactance from 1 p.u. where P + j Q is drawn: V^2 = 1/2 - X Q + sqrt(1/4 - X Q - X^2 P^2)."""
    return float(np.sqrt(0.5 - X * Q + np.sqrt(0.25 - X * Q - (X * P) ** 2)))


@settings(deadline=None, max_examples=40)
@given(
    P=st.floats(10, 500),
    loss=st.floats(0, 0.1),
    R=st.floats(0, 0.02),
    pf=st.floats(0.85, 1),
    modulation=st.floats(-1, 1),
)
def test_powers_at_both_ends(P: float, loss: float, R: float, pf: float, modulation: float) -> None:
    """What the rectifier takes, less losses, is given at the other end; the voltage is that of constant power."""
    system = link(P=P, loss=loss, R=R, pf_from=pf, pf_to=pf, setpoint_max=0.1, rate_max=100.0)
    trace = follow(plant(system, installed=["hvdc"]), [0.0, 0.05], [(0.0, 0.1 * modulation)])
    for k, power in enumerate((P / 100, P / 100 + 0.1 * modulation)):
        V = at_constant_power(power, power * tangent(pf))
        assert trace.frames[k, AT_S, VOLTAGE] == pytest.approx(V, abs=1e-9)
        assert trace.frames[k, AT_S, ACTIVE] == pytest.approx(-power, abs=1e-9)
        assert trace.frames[k, AT_S, REACTIVE] == pytest.approx(-power * tangent(pf), abs=1e-9)
        given_there = power * (1.0 - loss) - R * power**2
        assert trace.devices["active_power"][k, 0] == pytest.approx(given_there, abs=1e-9)
        assert trace.devices["reactive_power"][k, 0] == pytest.approx(-given_there * tangent(pf), abs=1e-9)


def test_below_its_least_voltage_it_is_an_admittance_and_comes_back_as_the_other_end_hears() -> None:
    """In a dip at the rectifier: P (V / V_min)^2 there at once, at the inverter after T; back with both, after T."""
    T, P, q, V_min = 0.03, 3.0, tangent(0.95), 0.8
    built = plant(link(P=300.0, pf_from=0.95, V_min=V_min, T=T), FAULT, installed=["hvdc"])
    times = np.arange(0.0, 0.5, 0.001)
    trace = follow(built, times)
    V, power = trace.frames[:, AT_S, VOLTAGE], trace.devices["active_power"][:, 0]
    dip, after = (times >= 0.1) & (times < 0.3), times >= 0.3
    admittance = P * (1.0 - 1j * q) / V_min**2 + 1.0 / 0.02j
    low = 1.0 / abs(1.0 + 1j * SPUR * admittance)
    assert low < 0.6
    np.testing.assert_allclose(V[dip], low, rtol=0, atol=1e-9)
    before = V[0]
    known = low + (before - low) * np.exp(-(times[dip] - 0.1) / T)
    np.testing.assert_allclose(power[dip], P * np.minimum(1.0, known / V_min) ** 2, rtol=0, atol=1e-6)
    # Afterwards power comes back at both ends together, by what is known of the rectifier's voltage.
    at_s = -trace.frames[after, AT_S, ACTIVE]
    np.testing.assert_allclose(power[after], at_s, rtol=0, atol=1e-9)
    lagged = trace.x[after, built.state_names.index("hvdc.V_from")]
    np.testing.assert_allclose(at_s, P * np.minimum(1.0, lagged / V_min) ** 2, rtol=0, atol=1e-9)
    assert at_s[0] == pytest.approx(P * (low / V_min) ** 2, rel=0.01)
    assert power[-1] == P
    assert trace.sound.all()


def test_bolted_fault_at_either_end_takes_all_power_and_no_more() -> None:
    for bus in ("B7", "B9"):
        fault = {"time": 0.1, "kind": "fault", "bus": bus, "duration": 0.08}
        trace = follow(plant("two_area_hvdc", fault, installed=["hvdc"]), frame_times(1.0, 240))
        power, during = trace.devices["active_power"][:, 0], (trace.t > 0.17) & (trace.t < 0.179)
        assert trace.sound.all()
        assert (np.abs(power[during]) < 0.1).all()
        assert power[-1] == pytest.approx(power[0], abs=1e-6)


@pytest.mark.parametrize(("setpoint", "order"), [(0.7, 2.5), (-0.9, 0.8), (0.3, 2.3)])
def test_modulation_keeps_limits_ramp_and_capacity(setpoint: float, order: float) -> None:
    """200 MW between 80 and 250, modulation within 2 p.u., at 4 p.u./s."""
    system = link(P=200.0, P_min=80.0, P_max=250.0, setpoint_max=2.0, rate_max=4.0)
    setpoint = setpoint * (2.0 if abs(setpoint) > 0.5 else 1.0)
    times = frame_times(1.0, 500)
    trace = follow(plant(system, installed=["hvdc"]), times, [(0.1, setpoint)])
    ramp = np.sign(setpoint) * np.minimum(4.0 * np.maximum(trace.t - 0.1, 0.0), abs(setpoint))
    np.testing.assert_allclose(trace.devices["active_power"][:, 0], np.clip(2.0 + ramp, 0.8, 2.5), rtol=0, atol=1e-7)
    assert trace.devices["active_power"][-1, 0] == pytest.approx(order)


@pytest.mark.parametrize("setpoint", [0.7, -0.9])
def test_link_without_schedule_modulates_both_ways(setpoint: float) -> None:
    system = link(P=0.0, P_min=-125.0, P_max=125.0, setpoint_max=2.0, rate_max=1000.0)
    trace = follow(plant(system, installed=["hvdc"]), frame_times(0.5), [(0.1, 2.0 * setpoint)])
    assert trace.devices["active_power"][0, 0] == 0.0
    assert trace.devices["active_power"][-1, 0] == pytest.approx(np.sign(setpoint) * 1.25, abs=1e-7)


@pytest.mark.parametrize(("H", "ratings", "P"), SWINGS)
def test_its_modulation_is_that_of_the_swing_equation(
    H: tuple[float, float], ratings: tuple[float, float], P: float
) -> None:
    """Residue from power to the difference of speeds -(a + b)/2, a, b = 1/(2 H S): u = K dw damps by K (a + b)/2."""
    system, frequency, slope = two_machines(H, ratings, P)
    modal = analyse(system, ["hvdc"])
    (swing,) = modal.swings
    (residue,) = swing.residues
    assert swing.frequency_hz == pytest.approx(frequency, rel=1e-4)
    assert residue.magnitude == pytest.approx(slope / 2.0, rel=1e-4)
    assert abs(residue.angle_deg) == pytest.approx(180.0, abs=1e-3)
    assert residue.sign == 1
    gain = 5.0
    closed = modal.model.A + gain * modal.model.B @ modal.model.C
    damped = np.linalg.eigvals(closed)
    minimum = damped[np.abs(damped.imag) > 1.0]
    assert minimum.real == pytest.approx(-gain * slope / 2.0, rel=1e-3)


def test_in_ac_emulation_it_follows_the_angle_between_its_ends() -> None:
    """At an infinite bus: P = P0 + u + K (a(P) - a(P0)) at rest; its eigenvalue is (K da/dP - 1) / T_angle."""
    T, K, u = 0.05, 100.0, 0.2
    system = link(P=100.0, K=K, T_angle=T)
    built = plant(system, installed=["hvdc"])
    trace = follow(built, [0.0, 20.0 * T], [(0.0, u)])

    def angle(P: float) -> float:
        return -float(np.arcsin(SPUR * P / at_constant_power(P, 0.0)))

    power, gain = -trace.frames[-1, AT_S, ACTIVE], np.rad2deg(K) / 100.0
    assert power == pytest.approx(1.0 + u + gain * (angle(power) - angle(1.0)), abs=1e-8)
    assert power < 1.0 + 0.5 * u
    k, slope = built.state_names.index("hvdc.angle"), (angle(1.0 + 1e-5) - angle(1.0 - 1e-5)) / 2e-5
    assert linearise(built)[0][k, k] == pytest.approx((gain * slope - 1.0) / T, rel=1e-5)


@cache
def as_loads() -> System:
    """two_area_hvdc with loads of constant power, one of them negative, in the place of its link."""
    system = shipped("two_area_hvdc")
    q = tangent(0.9)
    given_there = 2.0 * (1.0 - 0.015) - 0.01 * 2.0**2
    constant = {"P_fractions": {"power": 1.0}, "Q_fractions": {"power": 1.0}, "V_min": 0.7}
    loads = [
        *(load.model_dump() for load in system.loads),
        {"name": "rectifier", "bus": "B7", "P": 200.0, "Q": 200.0 * q, **constant},
        {"name": "inverter", "bus": "B9", "P": -100.0 * given_there, "Q": 100.0 * given_there * q, **constant},
    ]
    return changed(system, loads=loads, devices=[])


def test_left_alone_it_is_two_loads_of_constant_power() -> None:
    """Whose equations are held against ANDES: the same power flow, modes and course after a load step."""
    step = {"time": 0.1, "kind": "load_step", "load": "load_2", "change": -0.05}
    ours, theirs = plant("two_area_hvdc", step, installed=["hvdc"]), plant(as_loads(), step, installed=[])
    np.testing.assert_allclose(ours.flow.voltage, theirs.flow.voltage, rtol=0, atol=1e-10)
    np.testing.assert_allclose(ours.flow.injection, theirs.flow.injection, rtol=0, atol=1e-10)
    values, our_values = (np.linalg.eigvals(linearise(built)[0]) for built in (theirs, ours))
    for value in values[np.abs(values) > 0.02]:
        assert np.abs(our_values - value).min() < 1e-6
    times = frame_times(3.0)
    np.testing.assert_allclose(follow(ours, times).speeds, follow(theirs, times).speeds, rtol=0, atol=1e-10)


def test_hvdc_link_that_is_not_installed_is_in_service() -> None:
    """It carries its order and answers nobody; the fault's course is that of one without a setpoint."""
    fault = {"time": 0.1, "kind": "fault", "bus": "B9", "x": 0.01, "duration": 0.1}
    ours, alone = (plant("two_area_hvdc", fault, installed=devices) for devices in (["hvdc"], []))
    times = frame_times(3.0)
    installed, other = follow(ours, times), follow(alone, times)
    np.testing.assert_allclose(installed.speeds, other.speeds, rtol=0, atol=1e-12)
    assert np.ptp(other.speeds) > 1e-3
    assert other.devices.shape[1] == 0
    assert alone.plant.devices.size == 0


def test_shipped_run_damps_what_grows_without_it() -> None:
    """LLC from the difference of speeds: the interarea mode of 0.64 Hz; more speed in area 1 asks for more power."""
    with_it = summarise(loop.run(load_case("two_area_hvdc", [])))
    without = summarise(loop.run(load_case("two_area_hvdc", ["controllers=[]"])))
    assert 0.08 < with_it.modes[0].damping_ratio < 0.13
    assert without.modes[0].damping_ratio < 0.0
    swing = min(analyse(shipped("two_area_hvdc"), ["hvdc"]).swings, key=lambda mode: mode.damping_ratio)
    (w13,) = [r for r in swing.residues if r.signal == "w13"]
    assert (swing.label, w13.sign) == ("interarea", 1)
    assert abs(w13.lead_deg) < 20.0


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"P": 1200.0}, "P must be between P_min and P_max, given 1200.0, 0.0 and 1000.0"),
        ({"P_min": -1.0, "R": 0.1}, "P_min below 0 needs loss 0, R 0, pf_from 1 and pf_to 1, given -1"),
        ({"to": "S"}, "devices: hvdc.to: 'S' given twice; allowed: two different buses"),
        ({"from": "X"}, "devices: hvdc.from: 'X' given; allowed: A, B, G, S"),
    ],
)
def test_invalid_hvdc_link_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        link(**fields)


def test_start_below_its_least_voltage_is_refused() -> None:
    with pytest.raises(InputError, match=r"hvdc: S has 0\.9\d* p.u. of voltage at the start; .* at least its V_min, 1"):
        plant(link(P=300.0, V_min=1.0, pf_from=0.9), installed=[])
