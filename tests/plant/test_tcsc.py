"""The thyristor-controlled series capacitor: reactance and transfer in closed form, limits, bypass, service."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.errors import InputError
from facts_damping.parameters.plant.placement import place
from facts_damping_library.devices.tcsc import Tcsc
from tests.plant.channels import ACTIVE, REACTIVE
from tests.plant.running import changed, follow, frame_times, moved, plant, shipped, slopes
from tests.plant.small import TIE, between_infinite_buses
from tests.plant.smoke import damps, follows_linear_model

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.build import Built

AT_ONCE = 1000.0  # p.u./s


def row(**fields: Any) -> dict[str, Any]:
    limits = {"setpoint_max": 0.02, "rate_max": AT_ONCE, "X_min": -0.005, "X_max": 0.03}
    return {"name": "tcsc", "kind": "tcsc", "line": "tie", "X": 0.02, **limits, **fields}


def small(*, installed: bool = True, **fields: Any) -> Built:
    """In a lossless line between infinite buses, 30 degrees apart."""
    return plant(between_infinite_buses([row(**fields)]), installed=["tcsc"] if installed else [])


def two_area(**fields: Any) -> System:
    """The two areas with a series capacitor of 30 % in one circuit from bus 7 to 8, and their own devices."""
    system = shipped("two_area")
    (line,) = (line for line in system.lines if line.name == "line_1")
    x = line.x * line.length
    data = {"X": 0.3 * x, "X_min": 0.1 * x, "X_max": 0.5 * x, "setpoint_max": 0.2 * x, "rate_max": 5.0 * x}
    device = row(**{"line": "line_1", **data, **fields})
    return place(changed(system, devices=[*(d.model_dump(by_alias=True) for d in system.devices), device]))


@pytest.mark.parametrize("u", [0.0, 0.006, -0.012, -0.02, 0.02, -0.1])
@pytest.mark.parametrize("X", [0.02, 0.0, -0.003])
def test_transfer_is_that_over_the_rest_of_the_reactance(X: float, u: float) -> None:
    """P = sin(delta) / (X_line - x), |I| = 2 sin(delta / 2) / (X_line - x); x = clip(X + u, X_min, X_max)."""
    trace = follow(small(X=X), [0.0, 0.4], [(0.0, u)])
    for k, x in enumerate((X, float(np.clip(X + np.clip(u, -0.02, 0.02), -0.005, 0.03)))):
        flow = (np.exp(1j * np.deg2rad(30)) - 1) / complex(1e-6, TIE - x)
        S, current = np.exp(1j * np.deg2rad(30)) * np.conj(flow), abs(flow)
        frame, device = trace.frames[k, 0], trace.devices[k, 0]
        assert frame[ACTIVE] == pytest.approx(S.real, abs=1e-8)
        assert frame[REACTIVE] == pytest.approx(S.imag, abs=1e-8)
        assert S.real == pytest.approx(0.5 / (TIE - x), rel=1e-4)
        assert device["current"] == pytest.approx(current, abs=1e-8)
        assert device["injected_voltage"] == pytest.approx(x * current, abs=1e-8)
        assert device["reactive_power"] == pytest.approx(x * current**2, abs=1e-8)
        assert device["active_power"] == pytest.approx(-1e-6 * current**2, rel=1e-6)
    assert trace.sound.all()


@pytest.mark.parametrize("T", [0.015, 0.05, 0.2])
def test_its_reactance_follows_in_its_time(T: float) -> None:
    """x = X + u (1 - exp(-t / T)); the ramp of the setpoint counts from its middle."""
    built = small(T=T)
    trace = follow(built, np.linspace(0.0, 5 * T, 60), [(0.0, -0.01)])
    x, late = trace.x[:, built.state_names.index("tcsc.x")], trace.t > 1e-4
    expected = 0.02 - 0.01 * (1 - np.exp(-(trace.t - 0.5 * 0.01 / AT_ONCE) / T))
    np.testing.assert_allclose(x[late], expected[late], rtol=0, atol=1e-8)


def test_tcsc_equals_a_line_of_less_reactance() -> None:
    """Power flow, speeds after a fault: installed, not installed, and a fixed reactance of the line."""
    system = two_area()
    (device,) = (d for d in system.devices if isinstance(d, Tcsc))
    lines = [
        line.model_copy(update={"x": line.x - device.X / line.length}) if line.name == "line_1" else line
        for line in shipped("two_area").lines
    ]
    # Half of the charging stands on the other side of the capacitor: none here.
    bare = [{**line.model_dump(by_alias=True), "b": 0.0} for line in lines]
    whole = [{**line.model_dump(by_alias=True), "b": 0.0} for line in system.lines]
    fault = {"time": 0.2, "kind": "fault", "bus": "B9", "x": 0.02, "duration": 0.1}
    fixed = plant(changed(shipped("two_area"), lines=bare), fault, installed=[])
    for installed in ([], ["tcsc"]):
        built = plant(changed(system, lines=whole), fault, installed=installed)
        for name, V in zip(fixed.flow.names, fixed.flow.voltage, strict=True):
            assert abs(built.flow.voltage[built.flow.names.index(name)] - V) < 1e-4, name
        speeds = [follow(each_built, frame_times(1.5)).speeds for each_built in (built, fixed)]
        np.testing.assert_allclose(speeds[0], speeds[1], rtol=0, atol=2e-6)


def test_tcsc_starts_at_rest() -> None:
    built = plant(two_area(), installed=["tcsc"])
    assert np.abs(slopes(built)).max() < 1e-9
    names, same = plant(two_area(), installed=[]).flow, built.flow
    np.testing.assert_allclose(same.voltage, names.voltage, rtol=0, atol=1e-12)


def test_above_its_largest_current_it_is_bypassed() -> None:
    """At x = 0.045 p.u. its line would carry 103 p.u.; bypassed, xs remains, and the state stands."""
    built = small(X=0.02, X_max=0.045, I_max=20.0, xs=0.01)
    trace = follow(built, [0.0, 0.1], x=moved(built, {"tcsc.x": 0.045}))
    current = 2 * np.sin(np.deg2rad(15)) / (TIE + 0.01)
    for device in trace.devices[:, 0]:
        assert device["blocked"] == 1
        assert device["current"] == pytest.approx(current, rel=1e-6)
        assert device["injected_voltage"] == pytest.approx(-0.01 * current, rel=1e-6)
    assert np.ptp(trace.x[:, built.state_names.index("tcsc.x")]) == 0


def test_current_above_it_at_the_start_is_refused() -> None:
    with pytest.raises(InputError, match=r"tcsc carries 17.25 p.u. at the start; allowed: at most I_max, 12"):
        small(I_max=12.0)


def test_reactance_beyond_its_limits_is_refused() -> None:
    with pytest.raises(ValueError, match=re.escape("X must be between X_min and X_max, given 0.02, -0.005 and 0.01")):
        small(X_max=0.01)


def test_tcsc_follows_its_linear_model() -> None:
    follows_linear_model(plant(two_area(response_time=0.02), installed=["tcsc"]), u=1e-4)


def test_lead_lag_that_commands_it_damps_the_interarea_swing() -> None:
    (capacitor,) = (d for d in two_area().devices if d.name == "tcsc")
    place_again = {"line": "line_1", "from": None, "to": None}
    fields = {key: value for key, value in capacitor.model_dump(by_alias=True).items() if key not in place_again}
    damps({**fields, "line": "line_1"})
