"""The New England system: power flow of MATPOWER.

Published modes of this system are of other models (IEEE PES-TR18: static exciters with transient gain reduction), so
the eigenvalues are those of another program with these data.
"""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.plant.grid.power_flow import solve
from facts_damping.small_signal.eigenmodes import modes
from facts_damping.small_signal.linearisation import linearise
from tests.plant.running import figures, follow, frame_times, plant, shipped

GENERATED = {  # MATPOWER, case39 solved: MW and Mvar
    "G30": (250, 161.762),
    "G31": (677.871, 221.574),
    "G32": (650, 206.965),
    "G33": (632, 108.293),
    "G34": (508, 166.688),
    "G35": (650, 210.661),
    "G36": (560, 100.165),
    "G37": (540, -1.36945),
    "G38": (830, 21.7327),
    "G39": (1000, 78.4674),
}


def test_power_flow_is_that_of_matpower() -> None:
    flow = solve(shipped("new_england_39"))
    bus, magnitude, angle = figures("new_england_39_voltages_matpower.csv").T
    voltage = dict(zip(flow.names, flow.voltage, strict=True))
    voltages = np.array([voltage[f"B{b:.0f}"] for b in bus])
    assert len(bus) == 39
    np.testing.assert_allclose(np.abs(voltages), magnitude, rtol=0, atol=1e-6)
    np.testing.assert_allclose(np.rad2deg(np.angle(voltages)), angle, rtol=0, atol=1e-5)
    for name, (active, reactive) in GENERATED.items():
        assert complex(flow.generation[name]) * 100 == pytest.approx(active + 1j * reactive, abs=1e-3)


def test_nine_swings_one_of_them_against_the_rest_of_the_interconnection() -> None:
    """Ten machines have nine swings: one of all New England against G39, eight within New England."""
    built = plant("new_england_39")
    matrix, _ = linearise(built)
    swings = sorted(
        (m for m in modes(matrix, built.state_names) if 0.4 < m.frequency_hz < 2 and m.damping_ratio < 0.1),
        key=lambda m: m.frequency_hz,
    )
    assert len(swings) == 9
    assert swings[0].frequency_hz == pytest.approx(0.577, abs=1e-3)
    assert [m.frequency_hz for m in swings[1:]] == pytest.approx(
        [0.921, 0.990, 1.091, 1.129, 1.198, 1.367, 1.394, 1.407], abs=1e-3
    )
    assert all(m.damping_ratio > 0 for m in swings)
    assert next(iter(swings[0].participation)).startswith("G39.")
    values, right = np.linalg.eig(matrix)
    shape = right[:, np.argmin(np.abs(values - swings[0].eigenvalue))]
    speeds = np.array([shape[built.state_names.index(f"G{g}.omega")] for g in range(30, 40)])
    apart = np.abs(np.rad2deg(np.angle(speeds / speeds[-1])))
    assert (apart[:-1] > 150).all()


def test_scenario_is_survived() -> None:
    rows = [
        {"time": 0.1, "kind": "fault", "bus": "B14"},
        {"time": 0.2, "kind": "clear", "bus": "B14"},
        {"time": 0.2, "kind": "line_out", "line": "line_4_14"},
    ]
    trace = follow(plant("new_england_39", *rows), frame_times(5.0))
    angles = np.rad2deg(trace.machines["rotor_angle"])
    assert trace.sound.all()
    assert np.ptp(angles, axis=1).max() < 120
