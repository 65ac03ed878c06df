"""CSVGN1: its transfer function, its limits against analytic solutions, its start, its place in a grid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.optimize import brentq

from facts_damping.errors import InputError
from facts_damping.small_signal.linearisation import linearise
from tests.plant.channels import REACTIVE, VOLTAGE
from tests.plant.running import changed, follow, frame_times, plant, shipped, slopes
from tests.plant.small import SPUR, between_infinite_buses

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

DATA = {"MBASE": 200.0, "CBASE": 80.0, "Q": 30.0, "K": 20.0, "T3": 0.1, "T5": 0.01}
Y = (80.0 - 30.0) / 200.0  # at the start, at 1 p.u. of voltage
AT_ONCE = {"setpoint_max": 0.1, "rate_max": 1000.0}


def row(bus: str = "S", **fields: Any) -> dict[str, Any]:
    return {"name": "svc", "kind": "csvgn1", "bus": bus, **AT_ONCE, **DATA, **fields}


def small(bus: str = "S", step: float = 1e-3, **fields: Any) -> Built:
    """One at the end of a lossless line from an infinite bus (S), or at that bus itself (A)."""
    return plant(between_infinite_buses([row(bus, **fields)], step=step), installed=["svc"])


def two_area(*, device: bool, **fields: Any) -> System:
    """The two areas with one at B8W, or with a load that draws the opposite of its Q there."""
    rows = shipped("two_area").model_dump(by_alias=True)
    load = {"name": "instead", "bus": "B8W", "P": 0.0, "Q": -30.0}
    added = {"devices": [*rows["devices"], row("B8W", **fields)]} if device else {"loads": [*rows["loads"], load]}
    return changed(shipped("two_area"), **added)


@pytest.mark.parametrize(
    "times", [(0.0, 1.0, 0.154833, 1.0, 0.005167), (0.02, 0.5, 0.1, 0.3, 0.01), (0.2, 0.0, 0.1, 0.0, 0.02)]
)
def test_transfer_function_from_setpoint_to_susceptance(times: tuple[float, ...]) -> None:
    """At a stiff bus K (1 + s T1) (1 + s T2) / ((1 + s T3) (1 + s T4) (1 + s T5)) on MBASE."""
    T1, T2, T3, T4, T5 = times
    built = small("A", T1=T1, T2=T2, T3=T3, T4=T4, T5=T5)
    A, B = linearise(built)
    at = built.state_names.index("svc.thyristors")
    for s in 1j * np.array([0.1, 2.0, 11.0, 90.0, 700.0]):
        theirs = 20.0 * (1 + s * T1) * (1 + s * T2) / ((1 + s * T3) * (1 + s * T4) * (1 + s * T5))
        ours = np.linalg.solve(s * np.eye(len(A)) - A, B[:, 0])[at]
        assert -ours == pytest.approx(theirs, rel=1e-6)


@pytest.mark.parametrize("u", [0.02, 0.005, -0.004, -0.03])
def test_at_rest_regulator_and_network_meet(u: float) -> None:
    """B = 0.8 - 2 y, y = K (V - Vref - u) from 0 to 1, V = 1 / (1 - X B); the second section is 1."""
    built = small(T2=0.4, T4=0.4)
    V, square = float(abs(built.flow.by_bus["S"])), float(abs(built.flow.by_bus["S"])) ** 2
    Vref = V - (0.8 - 0.3 / square) / 2.0 / 20.0
    trace = follow(built, [0.0, 3.0], [(0.0, u)])

    def beyond(B: float) -> float:
        return float(0.8 - 2.0 * np.clip(20.0 * (1 / (1 - SPUR * B) - Vref - u), 0.0, 1.0) - B)

    B = brentq(beyond, -2.0, 2.0, xtol=1e-14)
    assert trace.devices["state"][:, 0] == pytest.approx([0.3 / square, B], abs=1e-8)
    assert trace.frames[-1, 2, VOLTAGE] == pytest.approx(1 / (1 - SPUR * B), abs=1e-9)
    assert trace.frames[-1, 2, REACTIVE] == pytest.approx(B / (1 - SPUR * B) ** 2, abs=1e-7)


@pytest.mark.parametrize(
    ("limits", "u", "limit"),
    [
        ({"VMAX": 0.6}, -0.05, 0.6),
        ({"VMAX": 0.6, "T2": 1.0, "T4": 1.0}, -0.05, 0.6),
        ({"VMIN": 0.1}, 0.05, 0.1),
        ({"VMAX": 9.0}, -0.1, 1.0),
        ({"RMIN": 40.0}, 0.05, 0.2),
    ],
)
def test_compensator_stays_within_its_limits_and_leaves_them_without_wind_up(
    limits: dict[str, float], u: float, limit: float
) -> None:
    """At a stiff bus; from the setpoint's end on the lags T3 and T5 lead from the limit to the start.

    Thyristors at their own limit leave it when the regulator, which goes on to Y - K u or its limit, has come back.
    """
    built = small("A", step=2e-4, **{"VMIN": -9.0, **limits})
    trace = follow(built, frame_times(2.0, 500), [(0.0, u), (1.0, 0.0)])
    y = (0.8 - trace.devices["state"][:, 0]) / 2.0
    assert y[trace.t <= 1.0][-1] == pytest.approx(limit, abs=1e-12)
    assert (np.abs(y - Y) <= abs(limit - Y) + 1e-12).all()
    first = trace.x[:, built.state_names.index("svc.first")]
    reached = limits.get("VMAX", 1e9) if u < 0 else limits.get("VMIN", -1e9)
    reached = np.clip(Y - 20.0 * u, min(reached, Y), max(reached, Y))
    after = trace.t[trace.t >= 1.0] - 1.0
    regulator = Y + (reached - Y) * np.exp(-after / 0.1)
    np.testing.assert_allclose(first[trace.t >= 1.0], regulator, rtol=0, atol=5e-3)
    wide = abs(reached - Y) > abs(limit - Y) + 1e-9
    leaves = 0.1 * np.log(abs(reached - Y) / abs(limit - Y)) if wide else 0.0
    late = np.maximum(after - leaves, 0.0)
    share = 0.1 / (0.1 - 0.01)
    expected = Y + (limit - Y) * (share * np.exp(-late / 0.1) + (1 - share) * np.exp(-late / 0.01))
    np.testing.assert_allclose(y[trace.t >= 1.0], expected, rtol=0, atol=5e-3)


def test_compensator_is_a_part_of_the_grid_whether_installed_or_not() -> None:
    """Same power flow as with a load of -Q, rest, and the same course after an event."""
    step = {"time": 0.1, "kind": "load_step", "load": "load_2", "change": -0.1}
    there, installed = (plant(two_area(device=True), step, installed=names) for names in ([], ["svc"]))
    instead = plant(two_area(device=False), step, installed=[])
    np.testing.assert_allclose(there.flow.voltage, instead.flow.voltage, rtol=0, atol=1e-12)
    assert np.abs(slopes(there)).max() < 1e-9
    runs = [follow(built, frame_times(1)) for built in (there, installed, instead)]
    np.testing.assert_array_equal(runs[0].frames, runs[1].frames)
    assert np.ptp(runs[1].devices["state"][:, 0]) > 0.05
    assert np.abs((runs[0].frames - runs[2].frames)[:, :, VOLTAGE]).max() > 1e-3


@pytest.mark.parametrize(
    ("fields", "allowed"),
    [
        ({"Q": 90.0}, "-120 to 80, by CBASE, MBASE and VMIN"),
        ({"Q": -130.0}, "-120 to 80, by CBASE, MBASE and VMIN"),
        ({"Q": 75.0, "RMIN": 20.0}, "-120 to 60, by CBASE, MBASE and RMIN"),
        ({"Q": -30.0, "VMAX": 0.5}, "-20 to 80, by CBASE, VMAX and VMIN"),
    ],
)
def test_start_beyond_its_limits_is_refused_with_what_is_allowed(fields: dict[str, float], allowed: str) -> None:
    with pytest.raises(InputError) as raised:
        small("A", **fields)
    start = f"devices: svc.Q: {fields['Q']:g} Mvar given at 1 p.u. of voltage"
    assert str(raised.value) == f"{start}; allowed: {allowed}"


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"T1": 0.1, "T3": 0.0}, "T3: 0 given; allowed: at least 0.001 s"),
        ({"T4": 1e-5}, "T4: 1e-05 given; allowed: 0, or at least 0.001 s"),
        ({"VMIN": 2.0}, "VMIN 2, VMAX 1, RMIN 0 and MBASE 200 given; allowed: VMIN below VMAX, RMIN below MBASE"),
    ],
)
def test_fields_that_contradict_each_other_are_refused(fields: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as raised:
        between_infinite_buses([row(**fields)])
    assert said in str(raised.value)
