"""WECC-240: its files of PSS/E, what is added to them, its modes and its run."""

from __future__ import annotations

import pytest

from facts_damping.case.loading import load_case
from facts_damping.findings import itae
from facts_damping.parameters.plant.system import System
from facts_damping.plant.build import build
from facts_damping.simulation.loop import run
from facts_damping.small_signal import eigenmodes, linearisation
from facts_damping_grids.psse.conversion import import_case
from tests.plant.running import REFERENCES, shipped

RAW, DYR = (REFERENCES / "wecc240" / f"240busWECC_2018_PSS{end}" for end in ("32_fixed_shunts.raw", ".dyr"))
PDCI = {"load_4010_current": 2904.493, "load_2619_current": -2466.528}  # MW, at Celilo and Sylmar


def test_imported_system_is_what_the_import_makes_of_the_files() -> None:
    assert System.model_validate(import_case(RAW, DYR, zones=True).content) == shipped("wecc_240_imported")


def test_system_has_positions_pmus_and_devices_beside_the_files() -> None:
    system, imported = shipped("wecc_240"), shipped("wecc_240_imported")
    assert (len(system.buses), len(system.machines), len(system.inverters), len(system.pmus)) == (243, 103, 37, 30)
    assert len({tuple(bus.position or ()) for bus in system.buses}) == 243
    assert [(bus.name, bus.nominal_voltage) for bus in system.buses] == [
        (bus.name, bus.nominal_voltage) for bus in imported.buses
    ]
    switched_off = [row.model_copy(update={"enabled": True}) for row in system.stabilisers]
    assert switched_off == imported.stabilisers
    powers = dict.fromkeys((unit.bus for unit in system.units), 0.0)
    for unit in system.units:
        powers[unit.bus] += unit.P or 0.0
    most = sorted(powers, key=lambda bus: -powers[bus])[:18]
    assert [pmu.bus for pmu in system.pmus[:18]] == most
    assert {load.name: load.P for load in system.loads if load.name in PDCI} == PDCI


@pytest.mark.parametrize(
    ("name", "poor", "least"), [("wecc_240", 9, (0.695, 0.0197)), ("wecc_240_imported", 0, (1.18, 0.0526))]
)
def test_grid_needs_damping_without_its_stabilisers_alone(name: str, poor: int, least: tuple[float, float]) -> None:
    """Damping ratios of swings, from 0.1 to 2 Hz, and how many have less than 3 %."""
    system = shipped(name)
    built = build(system, [], [])
    modes = eigenmodes.modes(linearisation.state_matrix(built)[0], built.state_names, system)
    swings = [mode for mode in modes if mode.swings and 0.1 <= mode.frequency_hz <= 2.0]
    assert len([mode for mode in swings if mode.damping_ratio < 0.03]) == poor
    worst = min(swings, key=lambda mode: mode.damping_ratio)
    assert (worst.frequency_hz, worst.damping_ratio) == pytest.approx(least, rel=5e-3)


def test_wind_plant_of_colorado_damps_after_the_fault_at_four_corners() -> None:
    quiet = ["load_noise=off", "supervision=off", "duration=12"]
    records = [run(load_case("wecc_240", [*quiet, *control])) for control in ([], ["controllers=[]"])]
    assert all(record.in_synchronism.all() for record in records)
    assert itae(records[0]) < 0.9 * itae(records[1])
