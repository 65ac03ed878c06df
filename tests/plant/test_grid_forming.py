"""Inverters that form the grid, and those with a PLL: sharing, inertia, limits of power and current, faults."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.errors import InputError
from facts_damping.parameters.plant.system import System
from facts_damping.signals import CHANNELS
from tests.plant.inverters import SOURCES, constants
from tests.plant.running import Trace, follow, moved, plant, slopes

if TYPE_CHECKING:
    from facts_damping.plant.build import Built

OMEGA_0 = 2.0 * np.pi * 60.0
FORMING = ("REGFMA1", "REGFMB1")
SLOW = {"REGCC1": {"Kppll": 10.0, "Kipll": 100.0}}  # a PLL that a weak grid bears
CHANNEL = {name: i for i, name in enumerate(CHANNELS)}


def connected(model: str, ratio: float = 5.0, P: float = 0.8, **changes: Any) -> System:
    """An inverter behind a line to an infinite bus at a short-circuit ratio, with an input of active power."""
    row = {"name": "I", "bus": "1", "rating": 100.0, "P": 100.0 * P, "V": 1.0, **constants(model, **changes)}
    controls = [] if model in FORMING else [{"inverter": "I", **constants("REECB1", Imax=1.2)}]
    device = {"name": "p", "kind": "inverter_input", "inverter": "I", "input": "Paux"}
    return System.model_validate(
        {
            "name": "test",
            "frequency": 60.0,
            "base_power": 100.0,
            "buses": [{"name": name, "nominal_voltage": 20.0} for name in "12"],
            "infinite_buses": [{"name": "far", "bus": "2", "V": 1.0, "angle": 0.0}],
            "lines": [{"name": "line", "from": "1", "to": "2", "r": 0.1 / ratio, "x": 1.0 / ratio}],
            "inverters": [row],
            "inverter_controls": controls,
            "devices": [{**device, "setpoint_max": 1.0, "rate_max": 1000.0}],
            "pmus": [{"name": "terminals", "bus": "1", "branches": ["line"]}],
        }
    )


def island(**loads: float) -> System:
    """Two droops alone with a load at each bus, of 100 and 200 MVA; droops of 2 and 5 %."""
    units = [
        {"name": name, "bus": bus, "rating": rating, "V": 1.0, **constants("REGFMA1", mp=mp, mq=0.05)}
        for name, bus, rating, mp in (("I", "1", 100.0, 0.02), ("J", "2", 200.0, 0.05))
    ]
    units[0] |= {"slack": True}
    units[1] |= {"P": 100.0}
    return System.model_validate(
        {
            "name": "test",
            "frequency": 60.0,
            "base_power": 100.0,
            "buses": [{"name": name, "nominal_voltage": 20.0} for name in "12"],
            "lines": [{"name": "line", "from": "1", "to": "2", "r": 0.02, "x": 0.1}],
            "loads": [
                {"name": f"load_{bus}", "bus": bus, "P": P, "P_fractions": {"power": 1}} for bus, P in loads.items()
            ],
            "inverters": units,
            "pmus": [{"name": name, "bus": bus, "branches": ["line"]} for name, bus in (("M", "1"), ("N", "2"))],
        }
    )


def states(built: Built, trace: Trace, name: str) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.asarray(trace.x[:, built.state_names.index(name)])


@pytest.mark.parametrize("ratio", [1.5, 10.0])
@pytest.mark.parametrize("model", SOURCES)
def test_inverter_comes_through_a_bolted_fault_at_its_terminals(model: str, ratio: float) -> None:
    """At no voltage the current of those that form the grid is at its limit; the operating point returns."""
    system = connected(model, ratio, **SLOW.get(model, {}))
    built = plant(system, {"kind": "fault", "time": 0.1, "bus": "1", "duration": 0.1}, installed=["p"])
    trace = follow(built, [0.0, 0.05, 0.15, 0.3, 10.0])
    power, voltage = (trace.frames[:, 0, CHANNEL[name]] for name in ("active_power", "voltage_magnitude"))
    assert np.isfinite(trace.x).all()
    assert voltage[2] == pytest.approx(0.0, abs=1e-9)
    assert abs(power[-1] - power[0]) < 1e-3
    assert abs(voltage[-1] - 1.0) < 1e-3
    if model in FORMING:
        assert trace.devices[2, 0]["current"] == pytest.approx(1.4, abs=1e-9)


def test_droops_share_a_load_step_by_their_gains() -> None:
    """The frequency falls by mp times the power of each, on its rating."""
    built = plant(
        island(**{"1": 60.0, "2": 90.0}),
        {"kind": "load_step", "time": 0.1, "load": "load_1", "change": 0.2},
        installed=[],
    )
    trace = follow(built, [0.0, 8.0, 8.1])
    slips = [float(np.diff(states(built, trace, f"{name}.angle_order")[1:])[0]) / (0.1 * OMEGA_0) for name in "IJ"]
    raised = [float(np.ptp(states(built, trace, f"{name}.P_seen")[:2])) for name in "IJ"]
    assert slips[0] == pytest.approx(slips[1], rel=1e-6)
    assert slips[0] == pytest.approx(-0.02 * raised[0], rel=1e-4)
    assert raised[0] / raised[1] == pytest.approx(0.05 / 0.02, rel=1e-4)


def test_overload_gives_what_is_beyond_the_limit_to_the_other() -> None:
    """PNNL-32278: the regulator of Pmax slows the angle until P is back at it."""
    built = plant(
        island(**{"1": 60.0, "2": 90.0}),
        {"kind": "load_step", "time": 0.1, "load": "load_2", "change": 1.0},
        installed=[],
    )
    trace = follow(built, [0.0, 0.2, 5.0])
    power = states(built, trace, "I.P_seen")
    assert power[1] > 1.01
    assert power[2] == pytest.approx(1.0, abs=1e-5)
    assert states(built, trace, "J.P_seen")[2] > 0.69


def test_virtual_machine_has_the_inertia_and_damping_of_its_fields() -> None:
    """2 H d slip/dt = -P - D1 slip - D2 slip behind a washout - slip / mp behind a lag."""
    built = plant(connected("REGFMB1"), installed=[])
    slip = built.state_names.index("I.slip")
    start = built.state.x[built.state_names.index("I.P_seen")]
    assert slopes(built, moved(built, {"I.P_seen": start + 0.1}))[slip] == pytest.approx(-0.1 / (2 * 0.5), rel=1e-9)
    assert slopes(built, moved(built, {"I.slip": 0.001}))[slip] == pytest.approx(-0.001 * (1 + 80), rel=1e-9)
    assert slopes(built, moved(built, {"I.droop": -0.05}))[slip] == pytest.approx(-0.05, rel=1e-9)


def test_steady_active_current_of_a_virtual_machine_is_limited() -> None:
    """More is asked for than Kf ImaxSS: the angle ahead of the PLL gives way until the current is that."""
    built = plant(connected("REGFMB1", FFlag=0), installed=["p"])
    trace = follow(built, [0.0, 20.0], [(0.1, 0.5, 0)])
    assert states(built, trace, "I.Id_seen")[-1] == pytest.approx(0.9 * 1.2, abs=1e-3)


def test_pll_stands_while_there_is_no_voltage() -> None:
    built = plant(connected("REGFMB1"), {"kind": "fault", "time": 0.1, "bus": "1", "duration": 0.1}, installed=[])
    trace = follow(built, [0.0, 0.11, 0.19, 0.3])
    for name in ("I.angle", "I.pll_order"):
        values = states(built, trace, name)
        assert values[1] == values[2] != values[3]


@pytest.mark.parametrize(("flag", "rate"), [(0, 0.5), (1, 0.5)])
def test_active_current_or_power_of_regcb1_grows_at_its_rate(flag: int, rate: float) -> None:
    """RateFlag 1: of the power, at any voltage; 0: of the current."""
    system = connected("REGCB1", RateFlag=flag, rrpwr=rate)
    built = plant(system, installed=["p"])
    trace = follow(built, [0.0, 0.2, 0.3], [(0.1, 0.2, 0)])
    ramped = states(built, trace, "I.P_ramped" if flag else "I.Ip")
    assert ramped[2] - ramped[1] == pytest.approx(0.1 * rate, rel=1e-6)


@pytest.mark.parametrize(
    ("model", "changes", "text"),
    [
        ("REGFMA1", {"Pmax": 0.7}, "P_at_start is 0.8 p.u. at the start; allowed by its limits: 0 to 0.7"),
        ("REGFMA1", {"Qmax": -0.4}, "Q_at_start"),
        ("REGFMA1", {"Emax": 0.9}, "E_limited"),
        ("REGFMA1", {"Imax": 0.7}, "current is 0.8001 p.u. at the start; allowed by its limits: 0 to 0.7"),
        ("REGFMB1", {"ImaxSS": 0.7}, "Id_at_start"),
        ("REGCB1", {"Imax": 0.7}, "at the start; allowed by its limits"),
    ],
)
def test_dispatch_beyond_a_limit_is_told(model: str, changes: dict[str, float], text: str) -> None:
    with pytest.raises(InputError) as error:
        plant(connected(model, **changes), installed=[])
    assert text in str(error.value)
