"""New England and New York: power flow, eigenvalues and a fault of ANDES; its modes, and what its controllers do."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case, read_system
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.grid.power_flow import solve
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise, modes
from facts_damping.studies.margins import delay_margin
from tests.plant.running import REFERENCES, figures, follow, plant, shipped

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

NO_LIMIT = {"minimum": -99.0, "maximum": 99.0}
FAULT = [  # as in tests/data/make_andes_systems.py
    {"time": 1.0, "kind": "fault", "bus": "B60", "x": 1e-3},
    {"time": 1.08, "kind": "clear", "bus": "B60"},
    {"time": 1.08, "kind": "line_out", "line": "line_61_60"},
]


def without_devices() -> System:
    return place(read_system("nets_nyps").model_copy(update={"devices": []}))


def test_power_flow_is_that_of_andes() -> None:
    flow = solve(without_devices())
    with (REFERENCES / "nets_nyps_voltages_andes.csv").open(encoding="utf-8") as file:
        theirs = {
            row["bus"]: float(row["magnitude"]) * 1j ** (float(row["angle"]) / 90) for row in csv.DictReader(file)
        }
    assert len(theirs) == 68
    for name, voltage in zip(flow.names, flow.voltage, strict=True):
        assert abs(voltage - theirs[name]) < 1e-7, name


def test_a_fault_is_that_of_andes() -> None:
    """Exciters without saturation and limits: ANDES's is another one."""
    system = without_devices()
    free = [e.model_copy(update=NO_LIMIT | ({"AEX": 0.0} if e.model == "dc" else {})) for e in system.exciters]
    wide = [s.model_copy(update={"minimum": -10.0, "maximum": 10.0}) for s in system.stabilisers]
    table = figures("nets_nyps_fault_andes.csv")
    built = plant(system.model_copy(update={"exciters": free, "stabilisers": wide}), *FAULT)
    trace = follow(built, table[:, 0])
    apart = np.abs(1.0 + trace.speeds - table[:, 1:]).max(axis=1)
    moved = np.abs(table[:, 1:] - 1.0).max()
    free_from = table[:, 0] > 1.1  # during the fault ANDES's last step before it counts for half
    assert apart[free_from].max() < 2e-3 * moved
    assert apart.max() < 1e-2 * moved


def test_four_interarea_modes_that_are_hardly_damped() -> None:
    """Those that are known of it: 0.39, 0.51, 0.62, 0.79 Hz (Pal and Chaudhuri 2005), here without their TCSC."""
    system = shipped("nets_nyps")
    built = plant(system, installed=[])
    swings = modes(linearise(built)[0], built.state_names, system)
    found = [m for m in swings if m.label == "interarea"]
    weak = sorted((m for m in found if m.damping_ratio < 0.05), key=lambda m: m.frequency_hz)
    assert [m.frequency_hz for m in weak] == pytest.approx([0.377, 0.513, 0.582, 0.779], abs=1e-3)
    assert all(m.damping_ratio > 0 for m in found)
    assert sum(m.label == "local" for m in swings) == 11


def test_its_two_controllers_damp_the_modes_over_100_ms() -> None:
    case = load_case("nets_nyps_two_devices", [])
    found = delay_margin.margin(case, 0.3, None, lambda *_: None)
    assert found.margin == pytest.approx(0.269, abs=2e-3)
    at = int(np.argmin(np.abs(found.delays - 0.1)))
    ratios = sorted(
        (mode.frequency_hz, mode.damping_ratio)
        for track in found.tracks
        if (mode := track.modes[at]) is not None and mode.label == "interarea"
    )
    assert [ratio for _, ratio in ratios] == pytest.approx([0.155, 0.095, 0.056, 0.042], abs=3e-3)


@pytest.mark.parametrize("scenario", ["line_60_61", "line_18_49", "load_step"])
def test_scenarios_are_survived_and_better_with_control(scenario: str) -> None:
    swings = []
    for control in ([], ["controllers=[]"]):
        record = loop.run(load_case("nets_nyps_two_devices", [f"scenario={scenario}", *control]))
        assert record.in_synchronism.all()
        speeds = record.machines["speed_deviation"]
        late = record.time_s > 15.0
        swings.append(float(np.abs(speeds - speeds.mean(axis=1, keepdims=True))[late].max()))
    assert swings[0] < 0.5 * swings[1]
