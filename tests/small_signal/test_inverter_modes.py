"""Modes of grids with inverters: one that forms the grid has a speed, one that follows it has none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.small_signal.eigenmodes import modes
from facts_damping.small_signal.linearisation import linear_model, linearise
from facts_damping.small_signal.modal_tables import analyse, modes_text
from facts_damping.small_signal.zero_order_hold import rigid
from tests.plant.running import changed, plant, shipped, slopes
from tests.two_plants import path

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

STEP = 1e-5  # of a state, along an eigenvector
NONE: dict[str, Any] = {"exciters": [], "inverter_controls": [], "devices": [], "measures": {}}


def two_batteries(**areas: str) -> System:
    """Two grid-forming inverters, with filters of power so slow that they swing, and no machine."""
    battery = shipped(path("battery"))
    row = {**battery.inverters[0].model_dump(), "Tpf": 0.3, "V": 1.0, "mp": 0.03, "Pmax": 3.0, "Imax": 3.0}
    inverters = [
        {**row, "name": "WEST", "bus": "B1", "P": None, "slack": True},
        {**row, "name": "EAST", "bus": "B2", "P": 300.0},
    ]
    pmus = [{"name": name, "machine": name} for name in ("WEST", "EAST")]
    signals = {"f": {"channel": "frequency", "weights": {"WEST": 1.0, "EAST": -1.0}}}
    placed = [{**inverter, "area": areas.get(inverter["name"])} for inverter in inverters]
    return changed(battery, machines=[], inverters=placed, pmus=pmus, signals=signals, **NONE)


def test_shape_has_the_rate_of_a_forming_inverter_s_angle() -> None:
    """As the plant's derivatives have it beside the start, along the real and the imaginary part of an eigenvector."""
    built = plant(shipped(path("battery")), installed=[])
    A, names = linearise(built)[0], built.state_names
    values, vectors = np.linalg.eig(A)
    angle, rotor = names.index("BATTERY.angle_order"), names.index("G2.omega")
    swings = [mode for mode in modes(A, names, shipped(path("battery"))) if mode.swings]
    assert len(swings) == 2
    for mode in swings:
        v = vectors[:, np.argmin(np.abs(values - mode.eigenvalue))]
        dx = [
            slopes(built, built.state.x + STEP * part) - slopes(built, built.state.x - STEP * part)
            for part in (v.real, v.imag)
        ]
        rate = complex(dx[0][angle], dx[1][angle]) / (2.0 * STEP * 2.0 * np.pi * 60.0)
        assert mode.shape["BATTERY"] / mode.shape["G2"] == pytest.approx(rate / v[rotor], rel=1e-4)


def test_inverter_that_follows_has_no_speed() -> None:
    modal = analyse(shipped(path("solar")), ["pod_p"])
    assert all(set(mode.shape) == {"G1", "G2"} for mode in modal.modes)
    assert [residue.device for mode in modal.swings for residue in mode.residues] == ["pod_p"]
    assert any("SOLAR.Pext" in mode.participation for mode in modal.modes)
    assert any(line.endswith(": machines that swing against each other") for line in modes_text(modal))


def test_forming_inverter_counts_in_what_a_mode_is() -> None:
    """G2 and the battery beside it against G1."""
    battery = shipped(path("battery"))
    areas = {"G1": "west", "G2": "east", "BATTERY": "east"}
    rows = {
        table: [{**unit.model_dump(), "area": areas[unit.name]} for unit in getattr(battery, table)]
        for table in ("machines", "inverters")
    }
    labels = {round(mode.frequency_hz, 1): mode.label for mode in analyse(changed(battery, **rows), []).swings}
    assert labels == {1.3: "interarea", 3.5: "local"}


def test_forming_inverters_swing_without_any_machine() -> None:
    system = two_batteries(WEST="west", EAST="east")
    modal = analyse(system, [])
    (swing,) = modal.swings
    assert swing.label == "interarea"
    assert (swing.shape["WEST"] / swing.shape["EAST"]).real < -0.5
    built = plant(system, installed=[])
    model = linear_model(built, system.signals, [pmu.name for pmu in system.pmus])
    still = rigid(model.A, model.C, built.state_names)
    assert still.shape[1] == 1  # both angles
    turned = [abs(still[built.state_names.index(f"{name}.angle_order"), 0]) for name in ("WEST", "EAST")]
    assert turned == pytest.approx([np.sqrt(0.5)] * 2)
