from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.linalg import expm

from facts_damping.case.loading import load_case
from facts_damping.plant.integration import advance
from facts_damping.plant.model import workspace
from facts_damping.signals import to_ns
from facts_damping.simulation import loop
from facts_damping.small_signal.linearisation import linearise
from tests.independent.reference import Model, Run
from tests.plant.running import events, figures, follow, frame_times, plant, shipped, table

if TYPE_CHECKING:
    from numpy.typing import NDArray

LOAD_STEP = {"time": 1.0, "kind": "load_step", "load": "load_2", "change": -0.1}
FAULT = {"time": 1.0, "kind": "fault", "line": "line_4", "location": 0.99, "duration": 8 / 60}  # of scenario large
SCENARIOS: dict[str, list[dict[str, Any]]] = {
    "small": [LOAD_STEP],
    "large": [FAULT],
    "multiple": [
        {"time": 1.0, "kind": "line_out", "line": "line_2"},
        {"time": 6.0, "kind": "line_in", "line": "line_2"},
        {"time": 10.0, "kind": "mechanical_power_step", "machine": "G1", "change": 0.1},
    ],
}
SOONER = ["scenario.1.time=1.6", "scenario.2.time=2.2"]  # so that 3 s have all events of multiple


def independent(rows: list[dict[str, Any]], targets: Any, times: NDArray[np.float64]) -> Run:
    model = Model(shipped("two_area"), ["sssc"])
    return model.simulate(times, events(*rows), {"sssc": targets}, method="RK45", rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize(
    ("scenario", "sets", "seconds", "bound"),
    [
        ("small", [], 2.0, 1e-6),  # measured 3.5e-9
        ("large", [], 2.2, 1e-5),  # measured 2.8e-7, where the field voltage goes onto its limits and off
        ("multiple", SOONER, 3.0, 1e-6),  # measured 3.1e-9
    ],
)
def test_controlled_run_agrees_with_the_independent_model(
    scenario: str, sets: list[str], seconds: float, bound: float
) -> None:
    """The independent model under the very setpoints, at the very instants, of a run with lead-lag control."""
    rows = [{**row, "time": t} for row, t in zip(SCENARIOS[scenario], (1.0, 1.6, 2.2), strict=False)]
    record = loop.run(load_case(f"two_area_{scenario}", [f"duration={seconds}", *sets]))
    used = record.applied
    assert np.ptp(used["value"]) > 0.01
    other = independent(rows, list(zip(used["effective_ns"] * 1e-9, used["value"], strict=True)), record.time_s)
    speeds = record.machines["speed_deviation"]
    assert np.abs(speeds).max() > 1e-3
    np.testing.assert_allclose(speeds, other.speeds, rtol=0, atol=bound)
    np.testing.assert_allclose(record.machines["rotor_angle"], other.angles, rtol=0, atol=1000 * bound)
    np.testing.assert_allclose(record.devices["reference"][:, 0], other.references["sssc"], rtol=0, atol=1e-10)


def test_longer_fault_without_control_agrees_with_the_independent_model_until_synchronism_is_lost() -> None:
    """Also 1 s before, with the step of the system; both lose it in the same frame."""
    fault = {**FAULT, "duration": 20 / 60}
    times = frame_times(4.8)
    run = independent([fault], [], np.array(times))
    apart = np.ptp(run.angles, axis=1) > np.pi
    lost = float(run.t[np.argmax(apart)])
    assert 4.5 < lost < 4.8
    for before_loss, step, bound in ((2.0, 1 / 240, 1e-5), (1.0, 1 / 480, 1e-6)):
        trace = follow(plant(shipped("two_area").model_copy(update={"step": step}), fault), times)
        until = trace.t <= lost - before_loss
        np.testing.assert_allclose(trace.speeds[until], run.speeds[until], rtol=0, atol=bound)
        np.testing.assert_array_equal(trace.sound, ~apart)


@pytest.mark.parametrize(("rows", "lost"), [([{**FAULT, "location": 0.9}], 16.17), (SCENARIOS["multiple"], 15.28)])
def test_synchronism_is_lost_when_a_separate_program_lost_it(rows: list[dict[str, Any]], lost: float) -> None:
    """Two rotors are 180 degrees apart then, to a frame of 100 frames/s."""
    trace = follow(plant("two_area", *rows), frame_times(16.3, 100))
    assert trace.t[np.argmin(trace.sound)] == pytest.approx(lost, abs=0.02)


def test_lead_lag_keeps_synchronism_after_the_large_disturbance() -> None:
    record = loop.run(load_case("two_area_large", ["scenario.0.location=0.9", "duration=20"]))
    assert record.time_s[-1] == pytest.approx(20, abs=0.02)
    assert np.ptp(record.machines["rotor_angle"], axis=1).max() < np.pi


def test_integrator_is_of_fourth_order() -> None:
    """A swing from a setpoint that no limit disturbs: halving the step divides the error by 16."""
    targets, end = [(0.0, 0.03), (0.5, -0.02)], 1.5
    system, runs = shipped("two_area"), {}
    for step in (0.004, 0.002, 0.001, 0.00025):
        trace = follow(plant(system.model_copy(update={"step": step})), [0.0, end / 2, end], targets)
        assert ((trace.machines["field_voltage"] > 0.5) & (trace.machines["field_voltage"] < 6)).all()
        runs[step] = trace.x[-1]
    errors = [np.abs(runs[step] - runs[0.00025]).max() for step in (0.004, 0.002, 0.001)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.3)


def test_kundur_12_6_fault_is_that_of_andes() -> None:
    """One degree and 5 % of the peak were asked for; the same machine model gives 0.002 degrees and 0.05 %."""
    rows = figures("kundur_12_6_bus8_fault_andes.csv")
    times, speeds, angles = rows[:, 0], rows[:, 1:5] - 1, rows[:, 5:]
    fault = {"time": 1.0, "kind": "fault", "bus": "B8", "duration": 0.1}
    trace = follow(plant("kundur_12_6", fault), [0.0, *times])
    rotor_angles = trace.machines["rotor_angle"][1:]
    apart = np.rad2deg((rotor_angles - rotor_angles[:, 2:3]) - (angles - angles[:, 2:3]))
    assert np.abs(apart).max() < 0.01
    assert np.abs(trace.speeds[1:] - speeds).max() < 0.001 * np.abs(speeds).max()


def test_setpoint_acts_from_its_own_instant_on() -> None:
    """Two runs whose setpoint arrives 1 ms apart between two frames differ as the linear model predicts.

    The reference of the later run lags by 1 ms for good, so the states differ by exp(A (T - t)) B u times 1 ms,
    with t in the middle of what lags.
    """
    built, value, late, end = plant("two_area"), 0.001, 1e-3, 1.0
    A, B = linearise(built)
    for arrival in (0.2021, 0.2083, 0.2151):  # the frame from 0.2 to 0.21667 s
        times = frame_times(end)
        runs = [follow(built, times, [(arrival + d, value)]).x[-1] for d in (0.0, late)]
        middle = arrival + (late + value / 5.0) / 2
        predicted = expm(A * (end - middle)) @ B[:, 0] * value * late
        speeds = [built.state_names.index(f"G{g}.omega") for g in (1, 2, 3, 4)]
        difference = (runs[0] - runs[1])[speeds]
        assert np.abs(predicted[speeds]).min() > 1e-9
        np.testing.assert_allclose(difference, predicted[speeds], rtol=0.006)


def test_setpoint_on_a_boundary_of_frames_is_in_force_from_there_on() -> None:
    built = plant("two_area")
    trace = follow(built, frame_times(0.1), [(3 / 60, 0.05)])
    assert (trace.reference[:4] == 0).all()
    np.testing.assert_allclose(trace.reference[4:, 0], 0.05, rtol=0, atol=1e-12)


def test_setpoint_that_comes_late_acts_at_once_and_the_last_of_an_instant_wins() -> None:
    """In real time a link may deliver what was due before."""
    plant_, state, *_ = plant("two_area")
    targets = table([(0.05, 0.03), (0.08, -0.02), (0.08, 0.01)])
    advance(plant_, state, to_ns(0.1), to_ns(0.12), targets, len(targets), workspace(plant_, state))
    assert (state.target[0], state.reference[0]) == (0.01, 0.01)


@pytest.mark.parametrize("shift", [0.0037, 0.0123456])
def test_event_acts_at_its_own_instant(shift: float) -> None:
    """Everything is at rest before: a fault between two frames gives the same course, later by as much."""
    late = {**FAULT, "time": FAULT["time"] + shift}  # type: ignore[operator]
    first = follow(plant("two_area", FAULT), frame_times(2))
    second = follow(plant("two_area", late), [*frame_times(2), 2 + shift])
    assert np.abs(first.speeds[-1]).max() > 3e-3
    np.testing.assert_allclose(second.speeds[-1], first.speeds[-1], rtol=0, atol=3e-6)


def test_division_into_frames_is_of_no_account_to_an_event() -> None:
    """The event splits the frame: 60 and 53 frames/s agree to the integrator's error."""
    event = {"time": 0.1234567, "kind": "load_step", "load": "load_2", "change": -0.02}
    runs = [follow(plant("two_area", event), frame_times(2, rate)).x[-1] for rate in (60, 53)]
    np.testing.assert_allclose(runs[0], runs[1], rtol=0, atol=1e-6)
    unmoved = follow(plant("two_area", {**event, "time": 0.1244567}), frame_times(2)).x[-1]
    assert np.abs(unmoved - runs[0]).max() > 1e-5
