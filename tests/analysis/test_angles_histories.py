"""Centres of angle, and histories of what was learnt, of records whose values are known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from facts_damping.analysis.histories import (
    centre_of_angle,
    centres_of_angle,
    jacobian_histories,
    learning_rate_histories,
)
from facts_damping.analysis.measures import SPEED
from facts_damping.case.loading import load_case
from facts_damping.signals import ESTIMATE, LEARNING
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.record import Record


def test_centre_of_angle_weighs_by_stored_energy() -> None:
    """(4.107) by hand: ratings 900 and 300 MVA, H 6 and 2 s: weights 5400 and 600."""
    angles = np.array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])
    assert centre_of_angle(angles, np.array([900 * 6.0, 300 * 2.0])) == pytest.approx([0.9, 0.5, 0.1])


def areas(record: Record, **system: Any) -> Record:
    data = (("G1", "west", 900.0, 6.0), ("G2", "east", 300.0, 2.0))
    machines = [dict(zip(("name", "area", "rating", "H"), row, strict=True)) for row in data]
    record.configuration["system"] = {"machines": machines, **system}
    return record


@given(turn=st.floats(-100, 100))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_turning_all_machines_moves_no_area(swing_record: Callable[..., Record], turn: float) -> None:
    record = areas(swing_record(10))
    record.machines["rotor_angle"] = [turn + 1.0, turn]
    centres = centres_of_angle(record)
    assert list(centres) == ["west", "east"]
    assert centres["west"] == pytest.approx(np.full(10, 0.1), abs=1e-9)  # 1 less the centre at 0.9
    assert centres["east"] == pytest.approx(np.full(10, -0.9), abs=1e-9)


def test_against_an_infinite_bus_angles_stand(swing_record: Callable[..., Record]) -> None:
    record = areas(swing_record(10), infinite_buses=[{"name": "GRID"}])
    record.machines["rotor_angle"] = [1.0, 0.3]
    assert centres_of_angle(record)["west"] == pytest.approx(np.ones(10))


def test_without_data_no_centre(swing_record: Callable[..., Record]) -> None:
    assert centres_of_angle(swing_record()) == {}
    assert centres_of_angle(swing_record(configuration={})) == {}


@pytest.fixture(scope="module")
def learnt() -> Record:
    sets = ["controllers=[{name: HBsWC, scheme: indirect}]", "link=delay_100ms", "duration=4"]
    return loop.run(load_case("two_area_small", sets))


def test_centre_of_angle_moves_with_the_speeds_of_its_area(learnt: Record) -> None:
    """d(delta)/dt = w0 dw: the centre's slope is the mean speed deviation, weighed alike, less that of all machines."""
    centres = centres_of_angle(learnt)
    assert list(centres) == ["area_1", "area_2"]
    machines = {machine["name"]: machine for machine in learnt.configuration["system"]["machines"]}
    weights = np.array([machines[name]["rating"] * machines[name]["H"] for name in learnt.machine_names])
    first = np.array([machines[name]["area"] == "area_1" for name in learnt.machine_names])
    speeds = learnt.machines["speed_deviation"]
    mean = speeds[:, first] @ weights[first] / weights[first].sum() - speeds @ weights / weights.sum()
    slope = np.gradient(centres["area_1"], learnt.time_s) / (2 * np.pi * learnt.configuration["system"]["frequency"])
    late = learnt.time_s > 1.2
    assert slope[late] == pytest.approx(mean[late], abs=0.02 * np.abs(mean).max())
    assert np.abs(learnt.frames[:, 0, SPEED]).max() > 0


def test_histories_of_a_run(learnt: Record) -> None:
    ((key, history),) = jacobian_histories(learnt).items()
    assert key == (learnt.controller_names[0], 0, "sssc")
    assert np.array_equal(history.values, learnt.estimates["jacobian"])
    assert history.time_s == pytest.approx(learnt.time_s, abs=1e-8)
    rates = learning_rate_histories(learnt)
    name = learnt.controller_names[0]
    assert {key[:3] for key in rates} == {(name, False, 0), (name, True, 0)}
    for (_, identifier, output, group), history in rates.items():
        rows = learnt.learning
        same = (rows["identifier"] == identifier) & (rows["output"] == output) & (rows["group"] == group)
        assert np.array_equal(history.values, rows["rate"][same])
        assert len(history.time_s) == len(learnt.time_ns)


def test_groups_that_learn_alike_are_one_history(swing_record: Callable[..., Record]) -> None:
    rows = np.zeros(12, LEARNING)
    rows["tick"], rows["group"] = np.repeat(np.arange(4), 3), np.tile([0, 1, 2], 4)
    rows["rate"] = np.tile([0.1, 0.1, 0.2], 4)
    histories = learning_rate_histories(swing_record(learning=rows))
    assert [key[3] for key in histories] == [0, 2]


def test_jacobian_of_each_signal_has_a_history(swing_record: Callable[..., Record]) -> None:
    rows = np.zeros(6, ESTIMATE)
    rows["tick"], rows["signal"] = np.repeat([0, 1, 5], 2), np.tile([0, 1], 3)
    rows["jacobian"] = [1, 10, 2, 20, 3, 30]
    histories = jacobian_histories(swing_record(estimates=rows))
    assert histories["controller_0_LLC", 0, "sssc"].values.tolist() == [1, 2, 3]
    assert histories["controller_0_LLC", 1, "sssc"].values.tolist() == [10, 20, 30]
    assert histories["controller_0_LLC", 1, "sssc"].time_s == pytest.approx([0, 1 / 60, 5 / 60])
    assert jacobian_histories(swing_record()) == {}
    assert learning_rate_histories(swing_record()) == {}
