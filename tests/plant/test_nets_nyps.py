"""New England and New York: the modes of Singh and Pal, a fault of ANDES, and what its controllers do."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case, read_system
from facts_damping.findings import itae
from facts_damping.parameters.plant.placement import place
from facts_damping.plant.grid.power_flow import solve
from facts_damping.simulation.loop import run
from facts_damping.small_signal.eigenmodes import modes
from facts_damping.small_signal.linearisation import linearise
from facts_damping_studies.margins import delay_margin
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled
from tests.plant.running import REFERENCES, figures, follow, plant, shipped

if TYPE_CHECKING:
    from facts_damping.parameters.plant.system import System

NO_LIMIT = {
    "static": {"minimum": -99.0, "maximum": 99.0},
    "DC4B": {"VRMIN": -1e4, "VRMAX": 1e4, "SE1": 0.0, "SE2": 0.0},  # nor saturation
    "PSS1A": {"minimum": -10.0, "maximum": 10.0},
    "IEEEST": {"LSMIN": -10.0, "LSMAX": 10.0},
}
# A. K. Singh and B. C. Pal, Report on the 68-Bus, 16-Machine, 5-Area System, version 3.3 (2013). Table 1: angles of the
# machines' buses, deg.
ANGLES = [
    *(-8.9563, -0.9835, 1.6129, 1.6683, -0.6276, 3.8425, 6.0307, -2.8410),
    *(2.6524, -9.6439, -7.2245, -22.6313, -28.6539, 10.9620, 0.0168, 0.0),
]
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


def test_fault_is_that_of_andes() -> None:
    """Exciters without saturation and limits: ANDES's is another one."""
    system = without_devices()
    free = [e.model_copy(update=NO_LIMIT[e.model]) for e in system.exciters]
    wide = [s.model_copy(update=NO_LIMIT[s.model]) for s in system.stabilisers]
    table = figures("nets_nyps_fault_andes.csv")
    built = plant(system.model_copy(update={"exciters": free, "stabilisers": wide}), *FAULT)
    trace = follow(built, table[:, 0])
    apart = np.abs(1.0 + trace.speeds - table[:, 1:]).max(axis=1)
    moved = np.abs(table[:, 1:] - 1.0).max()
    free_from = table[:, 0] > 1.1  # during the fault ANDES's last step before it counts for half
    assert apart[free_from].max() < 3e-3 * moved
    assert apart.max() < 1e-2 * moved


def test_power_flow_is_that_of_the_report() -> None:
    flow = solve(without_devices())
    angles = [np.rad2deg(np.angle(flow.voltage[flow.names.index(f"B{i + 1}")])) for i in range(len(ANGLES))]
    assert angles == pytest.approx(ANGLES, abs=6e-5)


def test_modes_are_those_of_the_report() -> None:
    """All fifteen, to the last digit."""
    values = np.linalg.eigvals(linearise(plant(without_devices(), installed=[]))[0])
    values = values[values.imag > 0.0]
    figures_found = np.array([values.imag / (2.0 * np.pi), -100.0 * values.real / np.abs(values)]).T
    printed = figures("nets_nyps_modes_report.csv")
    assert len(printed) == 15
    nearest = np.array(
        [figures_found[np.argmin(np.abs(figures_found - printed_mode) @ [20.0, 1.0])] for printed_mode in printed]
    )
    assert nearest == pytest.approx(printed, abs=5.1e-4)


def test_three_interarea_modes_are_hardly_damped() -> None:
    system = shipped("nets_nyps")
    built = plant(system, installed=[])
    swings = modes(linearise(built)[0], built.state_names, system)
    interarea = sorted(
        (m.frequency_hz, m.damping_ratio) for m in swings if m.label == "interarea" and m.damping_ratio < 0.1
    )
    assert np.array(interarea) == pytest.approx(np.array([[0.520, 0.0362], [0.591, 0.0962], [0.779, 0.0338]]), abs=5e-4)


def test_its_two_controllers_damp_the_modes_over_100_ms() -> None:
    case = load_case("nets_nyps_two_devices", [])
    loop_margin = delay_margin.margin(case, 0.1, None, lambda *_: None)
    assert loop_margin.margin is None
    ratios = sorted(
        (mode.frequency_hz, mode.damping_ratio)
        for track in loop_margin.tracks
        if (mode := track.modes[-1]) is not None and mode.label == "interarea" and mode.damping_ratio < 0.3
    )
    assert [ratio for _, ratio in ratios] == pytest.approx([0.124, 0.113, 0.152, 0.060], abs=3e-3)
    loop = delayed_loop(case)
    assert eigen(loop, sampled(loop, 0.762)).growth < 0.0 < eigen(loop, sampled(loop, 0.770)).growth


@pytest.mark.parametrize("scenario", ["line_60_61", "line_18_49", "load_step"])
def test_scenarios_are_survived_and_better_with_control(scenario: str) -> None:
    swings = []
    for control in ([], ["controllers=[]"]):
        record = run(load_case("nets_nyps_two_devices", [f"scenario={scenario}", *control]))
        assert record.in_synchronism.all()
        swings.append(itae(record))
    assert swings[0] < 0.6 * swings[1]
