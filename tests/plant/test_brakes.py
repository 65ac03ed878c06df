"""Braking resistors: beside an added constant-impedance load, and the power that a bus gives to one."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping.plant.events import topology_intervals
from facts_damping.plant.grid import network
from facts_damping.plant.grid.power_flow import solve
from facts_damping.plant.grid.reduction import reduce_network
from tests.plant.running import changed, events, follow, frame_times, plant, shipped

POWER = 600.0  # MW
BRAKE = {"time": 1.0, "kind": "brake", "bus": "B6", "power": POWER}


def test_brake_is_an_added_constant_impedance_for_its_time() -> None:
    """Bit for bit."""
    system, times = shipped("two_area"), frame_times(4)
    load = {"name": "brake", "bus": "B6", "P": POWER, "Q": 0.0, "at": "nominal"}
    loaded = changed(system, loads=[*(load_before.model_dump(by_alias=True) for load_before in system.loads), load])
    braked = plant(system, {**BRAKE, "duration": 0.5}, installed=[])
    flow = solve(system, [])
    sizes = dict(zip(flow.names, np.abs(flow.voltage).tolist(), strict=True))
    norton = braked.plant.machines["admittance"]
    during = reduce_network(loaded, [], norton, network.Topology(), sizes)
    off = braked.plant.network[0]
    switched = braked._replace(plant=braked.plant._replace(network=np.array([off, during, off])))
    traces = [follow(built, times) for built in (braked, switched)]
    np.testing.assert_array_equal(traces[0].x, traces[1].x)
    assert np.abs(traces[0].speeds).max() > 1e-3


@pytest.mark.parametrize("installed", [[], ["sssc"]])
def test_bus_gives_a_brake_its_power(installed: list[str]) -> None:
    """A bus without load and machine: what flows into its branches is what the brake takes, with opposite sign."""
    system = shipped("two_area")
    pmus = [pmu.model_dump(by_alias=True) for pmu in system.pmus]
    pmus.append({"name": "BRAKE", "bus": "B6", "branches": ["line_5_6", "line_6_7", "T2"]})
    built = plant(changed(system, pmus=pmus), {**BRAKE, "duration": 0.5}, installed=installed)
    trace = follow(built, frame_times(2))
    frames, during = trace.frames[:, -1], (trace.t >= 1.0) & (trace.t < 1.5)
    np.testing.assert_allclose(frames[during, 3], -POWER / 100.0 * frames[during, 0] ** 2, rtol=1e-9)
    np.testing.assert_allclose(frames[:, 4], 0.0, rtol=0, atol=1e-8)
    np.testing.assert_allclose(frames[~during, 3], 0.0, rtol=0, atol=1e-8)
    energy = -frames[during, 3].sum() * 100.0 / 60.0  # MW s
    assert 0.5 * POWER * 0.8 < energy < 0.5 * POWER


def test_brake_with_a_duration_is_a_brake_and_its_removal() -> None:
    brief = topology_intervals(shipped("two_area"), events({**BRAKE, "duration": 0.5}))
    both = topology_intervals(shipped("two_area"), events({"time": 1.5, "kind": "brake_out", "bus": "B6"}, BRAKE))
    assert brief == both
    assert [dict(interval.topology.brakes) for interval in brief] == [{}, {"B6": 6.0}, {}]


def test_brakes_at_several_buses_and_faults_are_apart() -> None:
    fault = {"time": 1.2, "kind": "fault", "bus": "B6", "r": 0.01, "duration": 0.1}
    other = {"time": 1.1, "kind": "brake", "bus": "B10", "power": 50.0}
    intervals = topology_intervals(shipped("two_area"), events(BRAKE, other, fault))
    assert [dict(interval.topology.brakes) for interval in intervals[2:]] == [{"B6": 6.0, "B10": 0.5}] * 3
    assert [len(interval.topology.faults) for interval in intervals] == [0, 0, 0, 1, 0]
