"""Where the one-line diagram has its buses: at their positions, if they have one."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.parameters.plant.placement import place
from facts_damping_views.bus_places import places
from tests.plant.running import changed, shipped


def test_buses_stand_at_their_positions_within_a_unit_square() -> None:
    system = shipped("wscc_9")
    positions = {bus.name: [7.0 + 3.0 * i, -2.0 * i] for i, bus in enumerate(system.buses)}
    placed = places(changed(system, buses=[{**b.model_dump(), "position": positions[b.name]} for b in system.buses]))
    assert placed["B1"] == pytest.approx([-1.0, 2.0 / 3.0])
    assert placed["B9"] == pytest.approx([1.0, -2.0 / 3.0])
    assert np.diff(np.array(list(placed.values())), axis=0) == pytest.approx(np.tile([0.25, -1.0 / 6.0], (8, 1)))


def test_bus_of_a_device_in_a_line_stands_in_that_line() -> None:
    system = shipped("wscc_9")
    rows = [{**b.model_dump(), "position": [float(i), 2.0]} for i, b in enumerate(system.buses)]
    line = system.lines[0]
    device = {"name": "sssc", "kind": "sssc", "line": line.name, "end": "to"}
    placed = place(changed(system, buses=rows, devices=[device]))
    at = {bus.name: bus.position for bus in placed.buses}
    near, far, made_at = at[line.to_bus], at[line.from_bus], at[f"{line.name}.sssc"]
    assert near
    assert far
    assert made_at == pytest.approx([near[0] + 0.15 * (far[0] - near[0]), 2.0])


def test_without_all_positions_they_follow_from_reactances() -> None:
    system = shipped("wscc_9")
    rows = [{**b.model_dump(), "position": [0.0, 0.0] if b.name == "B1" else None} for b in system.buses]
    plain, partly = places(system), places(changed(system, buses=rows))
    assert all((plain[name] == partly[name]).all() for name in plain)
