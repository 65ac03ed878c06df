"""Load modulation: what it draws against closed forms, low voltage, and a swing that it damps."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.plant.channels import ACTIVE, REACTIVE, VOLTAGE
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes
from tests.plant.small import SPUR, between_infinite_buses
from tests.plant.smoke import damps, follows_linear_model

if TYPE_CHECKING:
    from facts_damping.plant.build import Built

AT_ONCE = 1000.0  # p.u./s


def row(bus: str = "S", **fields: Any) -> dict[str, Any]:
    limits = {"setpoint_max": 20.0, "rate_max": AT_ONCE}
    return {"name": "modulation", "kind": "load_modulation", "bus": bus, **limits, **fields}


def small(**fields: Any) -> Built:
    """At the end of a lossless line from an infinite bus."""
    return plant(between_infinite_buses([row(**fields)]), installed=["modulation"])


@pytest.mark.parametrize("pf", [1.0, 0.95, 0.8])
@pytest.mark.parametrize("u", [6.0, 1.5, -2.0, -7.0])
def test_behind_a_reactance_the_voltage_is_that_of_the_quadratic_equation(u: float, pf: float) -> None:
    """V^2 = 1/2 - X Q + sqrt(1/4 - X Q - (X P)^2), as for a load of constant power; more load for u > 0."""
    trace = follow(small(pf=pf, V_min=0.5), [0.0, 0.1], [(0.0, u)])
    P, Q = u, u * np.tan(np.arccos(pf))
    frame = trace.frames[-1, 2]
    expected = np.sqrt(0.5 - SPUR * Q + np.sqrt(0.25 - SPUR * Q - (SPUR * P) ** 2))
    assert frame[VOLTAGE] == pytest.approx(expected, abs=1e-10)
    assert (-frame[ACTIVE], -frame[REACTIVE]) == pytest.approx((P, Q), abs=1e-9)
    device = trace.devices[-1, 0]
    assert (device["active_power"], device["reactive_power"]) == pytest.approx((-P, -Q), abs=1e-9)
    assert device["current"] == pytest.approx(np.hypot(P, Q) / expected, abs=1e-9)


@pytest.mark.parametrize("u", [8.0, 11.0, 14.0, 20.0])
def test_below_v_min_it_is_an_impedance(u: float) -> None:
    """V = E / sqrt(1 + (X P / V_min^2)^2)."""
    trace = follow(small(V_min=0.98), [0.0, 0.1], [(0.0, u)])
    expected = 1 / np.hypot(1, SPUR * u / 0.98**2)
    assert expected < 0.98
    assert trace.frames[-1, 2, VOLTAGE] == pytest.approx(expected, abs=1e-9)
    assert trace.sound.all()


def test_load_modulation_starts_at_rest_and_leaves_the_power_flow_unchanged() -> None:
    built = plant(two_area(), installed=["modulation"])
    assert np.abs(slopes(built)).max() < 1e-9
    np.testing.assert_array_equal(built.flow.voltage, plant("two_area").flow.voltage)


def two_area(**fields: Any) -> Any:
    """The two areas with modulated load at bus 9 and their own devices."""
    system = shipped("two_area")
    device = row("B9", **{"setpoint_max": 1.0, "rate_max": 10.0, **fields})
    return changed(system, devices=[*(d.model_dump(by_alias=True) for d in system.devices), device])


def test_with_a_lag_it_follows_as_the_linear_model() -> None:
    """The linear model's answer to 0.001 p.u. for 1 s, by its matrix exponential."""
    built = plant(two_area(response_time=0.05), installed=["modulation"])
    follows_linear_model(built)


def test_bolted_fault_at_its_bus_takes_all_its_power() -> None:
    fault = {"time": 0.2, "kind": "fault", "bus": "B9", "duration": 0.1}
    built = plant(two_area(), fault, installed=["modulation"])
    trace = follow(built, frame_times(1, 240), [(0.05, 0.5)])
    power, burning = trace.devices["active_power"][:, 0], (trace.t >= 0.2) & (trace.t < 0.3)
    assert np.abs(power[burning]).max() < 1e-9
    assert power[-1] == pytest.approx(-0.5, abs=1e-9)
    assert trace.sound.all()


def test_lead_lag_that_commands_it_damps_the_interarea_swing() -> None:
    damps(row("B9", setpoint_max=1.0, rate_max=10.0, response_time=0.05))
