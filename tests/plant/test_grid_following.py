"""Grid-following inverters in a network: what a plant control sees, and a bolted fault at their terminals."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.parameters.plant.system import System
from facts_damping.signals import CHANNELS
from tests.plant.inverter_rows import fields
from tests.plant.running import follow, plant, slopes

if TYPE_CHECKING:
    from facts_damping.plant.build import Built

POWER = 0.8  # p.u. of 100 MVA
SUPPORT = {"dbd1": -0.1, "dbd2": 0.1, "Kqv": 2.0, "Imax": 1.1}
ELECTRICAL: dict[str, dict[str, float]] = {
    "REECA1": {"QFLAG": 1.0, "VFLAG": 1.0, "Thld": 0.1, "Thld2": 0.2, **SUPPORT},
    "REECB1": SUPPORT,
    "REECD1": {"QFLAG": 1.0, "Thld": 0.1, "Thld2": 0.1, "Vblkl": 0.2, "Vblkh": 1.4, **SUPPORT},
}


def connected(
    ratio: float,
    electrical: str = "REECB1",
    *,
    of_converter: dict[str, float] | None = None,
    of_plant: dict[str, Any] | None = None,
) -> System:
    """An inverter behind two equal lines to an infinite bus, at a short-circuit ratio."""
    x = 2.0 / ratio
    row = {"name": "IBR1", "bus": "1", "rating": 100.0, "P": 100.0 * POWER, "V": 1.0, "model": "REGCA1"}
    controls = [{"inverter": "IBR1", "model": electrical, **fields(electrical, **ELECTRICAL[electrical])}]
    if of_plant is not None:
        controls.append({"inverter": "IBR1", "model": "REPCA1", **fields("REPCA1"), **of_plant})
    return System.model_validate(
        {
            "name": "test",
            "frequency": 60.0,
            "base_power": 100.0,
            "buses": [{"name": name, "nominal_voltage": 20.0} for name in "12"],
            "infinite_buses": [{"name": "far", "bus": "2", "V": 1.0, "angle": 0.0}],
            "lines": [{"name": name, "from": "1", "to": "2", "r": 0.1 * x, "x": x} for name in ("a", "b")],
            "inverters": [row | fields("REGCA1", **(of_converter or {}))],
            "inverter_controls": controls,
            "pmus": [{"name": "terminals", "bus": "1", "branches": ["a", "b"]}],
        }
    )


def state(built: Built, name: str) -> float:
    return float(built.state.x[built.state_names.index(f"IBR1.{name}")])


@pytest.mark.parametrize("place", [{}, {"bus": "1", "branch": "b"}])
def test_plant_control_sees_the_voltage_at_the_end_of_the_line_it_compensates(place: dict[str, Any]) -> None:
    """With Rc + j Xc of the line, or of both for the current of the terminals, it is that of the infinite bus."""
    x = 2.0 / 3.0 if place else 1.0 / 3.0
    built = plant(connected(3.0, of_plant={"RefFlag": 1.0, "VCFlag": 1.0, "Rc": 0.1 * x, "Xc": x, **place}))
    assert state(built, "V_plant") == pytest.approx(1.0, abs=1e-9)
    assert np.abs(slopes(built)).max() < 1e-8


@pytest.mark.parametrize("ratio", [20.0, 1.5])
@pytest.mark.parametrize("electrical", ELECTRICAL)
@pytest.mark.parametrize("regulated", [False, True])
def test_inverter_comes_through_a_bolted_fault_at_its_terminals(
    ratio: float, electrical: str, *, regulated: bool
) -> None:
    """150 ms at 0 voltage, in a strong and in a weak grid: its current stays within limits, and it is back then."""
    regulation = {"RefFlag": 1.0, "Vfrz": 0.7, "Kp": 0.5, "Ki": 2.0, "Qmax": 2.0, "Qmin": -2.0}
    converter = {"Lvplsw": 1.0, "Rrpwr": 2.0, "Khv": 0.0}
    system = connected(ratio, electrical, of_converter=converter, of_plant=regulation if regulated else None)
    built = plant(system, *({"kind": "fault", "time": 0.1, "bus": "1", "duration": 0.15},))
    ran = follow(built, np.arange(0.0, 5.0, 0.005).tolist())
    measured = {name: ran.frames[:, 0, k] for k, name in enumerate(CHANNELS)}
    assert np.isfinite(ran.x).all()
    assert measured["voltage_magnitude"][40] == pytest.approx(0.0, abs=1e-9)
    assert measured["active_power"][-1] == pytest.approx(POWER, abs=1e-3)
    assert measured["voltage_magnitude"][-1] == pytest.approx(1.0, abs=2e-3)
    active, reactive = (ran.x[:, built.state_names.index(f"IBR1.{name}")] for name in ("Ip_lag", "Iq_ahead"))
    assert active.min() < 0.01
    assert np.hypot(active, reactive).max() < 1.1 + 1e-3
    assert np.diff(active).max() <= 2.0 * 0.005 + 1e-6
