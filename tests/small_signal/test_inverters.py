"""Inverters in the linear plant: sparse and dense, with plant controls that see far buses; the effect of setpoints."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.plant import build as plant_build
from facts_damping.small_signal import descriptor, linearisation
from facts_damping_reproduction.inverter_faults.cases import units
from tests.plant.running import changed, plant, shipped, slopes
from tests.plant.smoke import follows_linear_model

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

PMUS = [
    {"name": "at_I1", "machine": "I1"},
    {"name": "at_I2", "machine": "I2"},
    {"name": "far", "bus": "B9", "branches": ["line_3"]},
]
SIGNALS = {
    "power": {"channel": "active_power", "weights": {"at_I1": 1.0}},
    "voltage": {"channel": "voltage_magnitude", "weights": {"at_I2": 1.0}},
    "frequency": {"channel": "frequency", "weights": {"at_I1": 1.0, "far": -1.0}},
    "current": {"channel": "current_magnitude", "weights": {"far": 1.0}},
}
INPUTS = {"I1": ("Pplant", "Vplant"), "I2": ("Paux",), "I3": ("Paux", "Vaux")}


@cache
def two_areas() -> System:
    """Inverters of five kinds in the two areas; plant controls see a branch and a bus of the other area."""
    values, electrical, of_plant = units()["inverters"], units()["electrical"], units()["plant"]["REPCA1"]
    models = {"I1": ("REGCA1", "B5"), "I2": ("REGCC1", "B10"), "I3": ("REGFMA1", "B6"), "I4": ("REGFMB1", "B11")}
    models["I5"] = ("REGCB1", "B5")
    inverters: list[dict[str, Any]] = [
        {"name": name, "bus": bus, "rating": 100.0, "P": 40.0, "Q": 5.0, "model": model, **values[model]}
        for name, (model, bus) in models.items()
    ]
    inverters[2]["area"], inverters[3]["area"] = "area_1", "area_2"
    controls: list[dict[str, Any]] = [
        {"inverter": "I1", "model": "REECA1", **electrical["REECA1"], "VFLAG": 1, "Kqi": 0.1, "Kvi": 5.0},
        {"inverter": "I2", "model": "REECB1", **electrical["REECB1"], "QFLAG": 0},
        {"inverter": "I5", "model": "REECB1", **electrical["REECB1"], "PFFLAG": 1, "QFLAG": 0},
    ]
    far = {"RefFlag": 1, "VCFlag": 1, "Rc": 0.01, "Xc": 0.05, "dbd1": 0.0, "dbd2": 0.0, "Fflag": 1, "Tg": 0.1}
    far |= {
        "fdbd1": 0.0,
        "fdbd2": 0.0,
        "Qmax": 1.0,
        "Qmin": -1.0,
        "Pmax": 9.0,
        "Pmin": -9.0,
        "Kpg": 0.1,
        "Kig": 0.1,
        "Dup": 20.0,
    }
    controls.append({"inverter": "I1", "model": "REPCA1", **of_plant, **far, "bus": "B9", "branch": "line_3"})
    near = {"RefFlag": 1, "Kc": 0.02, "dbd1": 0.0, "dbd2": 0.0, "bus": "B7", "Kp": 0.2, "Ki": 0.5}
    controls.append({"inverter": "I2", "model": "REPCA1", **of_plant, **near})
    devices = [d.model_dump(by_alias=True) for d in shipped("two_area").devices]
    devices += [
        {"name": f"{name}_{signal}", "kind": "inverter_input", "inverter": name, "input": signal, "response_time": 0.01}
        for name, inputs in INPUTS.items()
        for signal in inputs
    ]
    tables = {"inverters": inverters, "inverter_controls": controls, "devices": devices}
    return changed(shipped("two_area"), **tables, pmus=PMUS, signals=SIGNALS, measures={})


def test_linear_plant_is_the_same_sparse_and_dense(monkeypatch: pytest.MonkeyPatch) -> None:
    """State matrix, inputs and outputs, and the response at a swing's frequency."""
    system = two_areas()
    devices, pmus = [d.name for d in system.devices], [pmu.name for pmu in system.pmus]
    built = plant(system, installed=devices)
    assert np.abs(slopes(built)).max() < 1e-9
    dense = linearisation.linear_model(built, system.signals, pmus)
    monkeypatch.setattr(plant_build, "LARGE", 0)
    built = plant(system, installed=devices)
    sparse = linearisation.linear_model(built, system.signals, pmus)
    assert isinstance(sparse.matrix, descriptor.Descriptor)
    for name in ("A", "B", "C", "D"):
        of_dense, of_sparse = getattr(dense, name), getattr(sparse, name)
        size = np.maximum(np.abs(of_dense).max(axis=1, keepdims=True), 1.0)
        assert np.abs((of_dense - of_sparse) / size).max() < 1e-6, name
    response = dense.response(4j)
    assert np.abs(response).max(axis=0).min() > 1e-3  # every input is seen
    assert np.abs(sparse.response(4j) - response).max() < 1e-6 * np.abs(response).max()


@pytest.mark.parametrize("device", [f"{name}_{signal}" for name, inputs in INPUTS.items() for signal in inputs])
def test_setpoint_at_an_inverter_acts_as_the_linear_plant_says(device: str) -> None:
    follows_linear_model(plant(two_areas(), installed=[device]), u=1e-4)
