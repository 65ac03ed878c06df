"""Battery storage: power and charge in closed form, limits by rating and charge, energy, voltage support."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.optimize import brentq

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import make_case
from facts_damping.simulation import loop
from tests.plant.channels import VOLTAGE
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes
from tests.plant.small import SPUR, between_infinite_buses
from tests.plant.smoke import damps, follows_linear_model

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.plant.build import Built
    from tests.plant.running import Trace

AT_ONCE = 1000.0  # p.u./s
HOUR = 3600.0  # s


def row(bus: str = "S", **fields: Any) -> dict[str, Any]:
    limits = {"setpoint_max": 5.0, "rate_max": AT_ONCE, "S_rated": 200.0, "E_rated": 1.0}
    return {"name": "bess", "kind": "bess", "bus": bus, **limits, **fields}


def small(bus: str = "S", **fields: Any) -> Built:
    """At the end of a lossless line from an infinite bus (S), or at that bus itself (A)."""
    return plant(between_infinite_buses([row(bus, **fields)]), installed=["bess"])


def charge(built: Built, trace: Trace) -> NDArray[np.float64]:
    recorded = trace.devices["state"][:, 0]
    np.testing.assert_array_equal(recorded, trace.x[:, built.state_names.index("bess.charge")])
    return np.asarray(recorded)


def two_area(**fields: Any) -> Any:
    """The two areas with a battery at bus 9 and their own devices."""
    system = shipped("two_area")
    device = row("B9", **{"setpoint_max": 1.0, "rate_max": 10.0, **fields})
    return changed(system, devices=[*(d.model_dump(by_alias=True) for d in system.devices), device])


@pytest.mark.parametrize(("u", "slope"), [(1.5, -1.5 / 0.9), (-1.5, 1.5 * 0.8), (4.0, -2.0 / 0.9), (-4.0, 2.0 * 0.8)])
def test_its_charge_falls_and_rises_by_its_power_and_efficiency(u: float, slope: float) -> None:
    """d(charge) = -P / (eta_out E), or -eta_in P / E; P within the rating of 2 p.u.; E = 100 MW x 36 s."""
    built = small(eta_in=0.8, eta_out=0.9)
    trace = follow(built, frame_times(2.0), [(0.0, u)])
    late = trace.t > 0.01
    assert trace.devices["active_power"][late, 0] == pytest.approx(np.clip(u, -2.0, 2.0), abs=1e-12)
    if abs(u) < 2.0:
        expected = 0.5 + slope * (trace.t[late] - 0.5 * abs(u) / AT_ONCE) / 36.0
        np.testing.assert_allclose(charge(built, trace)[late], expected, rtol=0, atol=1e-9)
    rate = np.diff(charge(built, trace)[late]) / np.diff(trace.t[late])
    np.testing.assert_allclose(rate, slope / 36.0, rtol=1e-6)


@pytest.mark.parametrize(("u", "eta", "end"), [(2.0, 0.9, 0.2), (-2.0, 1 / 0.8, 0.7)])
def test_power_ends_smoothly_at_empty_and_full(u: float, eta: float, end: float) -> None:
    """In the last 0.1 of charge the limit falls in proportion: exp(-t / T), T = 0.1 E eta / S; empty is not passed."""
    built = small(eta_in=0.8, eta_out=0.9, E_rated=0.2, charge_min=0.2, charge_max=0.7, taper=0.1, charge=0.45)
    trace = follow(built, np.linspace(0.0, 12.0, 2401), [(0.0, u)])
    left, power = np.abs(charge(built, trace) - end), np.abs(trace.devices["active_power"][:, 0])
    T = 0.1 * 7.2 * eta / 2.0
    inside = (left < 0.099) & (trace.t > 0.1)
    assert inside.sum() > 1000
    np.testing.assert_allclose(power[inside], 2.0 * left[inside] / 0.1, rtol=0, atol=1e-9)
    first = int(np.flatnonzero(inside)[0])
    expected = left[first] * np.exp(-(trace.t[inside] - trace.t[first]) / T)
    np.testing.assert_allclose(left[inside], expected, rtol=1e-6, atol=1e-12)
    assert (charge(built, trace) >= 0.2).all()
    assert (charge(built, trace) <= 0.7).all()
    assert trace.sound.all()
    back = follow(built, [0.0, 12.0, 12.1], [(0.0, u), (12.0, -u)])  # the other direction is free at once
    assert back.devices["active_power"][-1, 0] == pytest.approx(-u, abs=1e-12)


@pytest.mark.parametrize("fault", [False, True])
def test_energy_is_conserved(fault: bool) -> None:
    """What the bus gave and took, with the losses of both directions, is the change of the charge."""
    rows = [{"time": 0.4, "kind": "fault", "bus": "B9", "x": 0.02, "duration": 0.1}] if fault else []
    built = plant(two_area(eta_in=0.85, eta_out=0.9, E_rated=0.1, K=20.0), *rows, installed=["bess"])
    times = np.unique(np.concatenate([np.linspace(a, b, 2001) for a, b in ((0, 0.4), (0.4, 0.5), (0.5, 2.0))]))
    trace = follow(built, times, [(0.1, 0.8), (1.0, -1.0)])
    P = trace.devices["active_power"][:, 0]
    inside = np.where(P > 0.0, P / 0.9, 0.85 * P)
    pieces = [(times >= a) & (times < b) for a, b in ((0, 0.4), (0.4, 0.5))] + [times >= 0.5]
    delivered = sum(simpson(inside[k], x=times[k]) for k in pieces)
    ends = sum(inside[k][-1] * (times[times > times[k][-1]][0] - times[k][-1]) for k in pieces[:2])
    moved = charge(built, trace)[-1] - 0.5
    assert np.abs(inside).mean() > 0.3
    assert moved * HOUR * 0.1 / 100.0 == pytest.approx(-(delivered + ends), abs=2e-5)


@pytest.mark.parametrize("u", [0.0, 1.2, -1.9, 2.5])
@pytest.mark.parametrize("V", [0.97, 1.0, 1.06])
def test_voltage_support_is_a_droop_within_what_the_rating_leaves(u: float, V: float) -> None:
    """At a bus whose infinite bus changes: Q = clip(K (Vref - |V|), sqrt(S^2 - P^2)), and the network's equations."""
    system = between_infinite_buses([row(K=50.0)], V=1.0)
    built = plant(system, installed=["bess"])
    built.plant.infinite[0] *= V
    trace = follow(built, [0.0, 0.1], [(0.0, u)])
    device, voltage = trace.devices[-1, 0], float(trace.frames[-1, 2, VOLTAGE])
    P = float(np.clip(u, -2.0, 2.0))
    room = np.sqrt(4.0 - P * P)

    def Q(size: float) -> float:
        return float(np.clip(50.0 * (1.0 - size), -room, room))

    def rest(size: float) -> float:
        """E^2 = |V - j X conj(S) / V|^2."""
        return abs(size - 1j * SPUR * complex(P, -Q(size)) / size) ** 2 - V * V

    expected = brentq(rest, 0.7, 1.4, xtol=1e-14)
    assert voltage == pytest.approx(expected, abs=1e-9)
    assert device["active_power"] == pytest.approx(P, abs=1e-9)
    assert device["reactive_power"] == pytest.approx(Q(expected), abs=1e-7)
    assert np.hypot(device["active_power"], device["reactive_power"]) <= 2.0 + 1e-9


def test_bess_starts_at_rest_and_leaves_the_power_flow_unchanged() -> None:
    built = plant(two_area(K=30.0, charge=0.1), installed=["bess"])  # also when it is empty
    assert np.abs(slopes(built)).max() < 1e-9
    np.testing.assert_array_equal(built.flow.voltage, plant("two_area").flow.voltage)


def test_bess_follows_its_linear_model() -> None:
    follows_linear_model(plant(two_area(K=30.0, response_time=0.05), installed=["bess"]))


def test_lead_lag_that_commands_it_damps_the_interarea_swing() -> None:
    damps(row("B9", setpoint_max=1.0, rate_max=10.0, response_time=0.05, K=10.0))


def test_lqg_leaves_the_charge_out() -> None:
    """Nothing brings a charge back and no signal sees it, so that Riccati's equations would have no solution."""
    controller = {"name": "LQG", "devices": ["bess"], "signals": ["w13"]}
    system = two_area(response_time=0.05).model_dump(by_alias=True, exclude_none=True)
    step = {"time": 0.5, "kind": "load_step", "load": "load_2", "change": -0.02}
    run = {"system": system, "devices": ["bess"], "scenario": [step], "duration": 15.0}
    controlled, free = (loop.run(make_case({**run, "controllers": some}, "test")) for some in ([controller], []))
    other, indices = (summarise(record).indices or {} for record in (free, controlled))
    assert indices["ITAE"] < 0.5 * other["ITAE"]


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"charge": 0.95}, "charge must be between charge_min and charge_max, given 0.95, 0.1 and 0.9"),
        ({"charge_max": 0.12}, "charge_max must be at least charge_min + 2 taper, given 0.1, 0.12 and 0.02"),
        ({"S_rated": 0.0}, "S_rated"),
    ],
)
def test_bad_data_are_refused(fields: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=re.escape(said)):
        small(**fields)
