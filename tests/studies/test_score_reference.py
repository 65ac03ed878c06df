"""The upper reference: its poles are those of linear theory, it is better than LQG, and it is held to what it may."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from facts_damping.analysis.measures import speed_differences
from facts_damping.case.loading import changed_case, load_case
from facts_damping.parameters.events import Scenario
from facts_damping.simulation.assembly import build_plant
from facts_damping.simulation.twins import without_events
from facts_damping.small_signal.linearisation import linearise
from facts_damping_studies.score import reference as upper
from facts_damping_studies.score.cases.sets import case_of, read_set
from facts_damping_studies.score.measure import measure
from facts_damping_studies.score.reference import law, mean_loop_delay, onward, reference, swing_models

if TYPE_CHECKING:
    from facts_damping.case.model import Case

SET = read_set("two_area_2.0")
AFTER = SET.content.after
TRIP, CLEARED, WRONG_MODEL, LIMITED, SLOW, LOST_DEVICE, WRONG_SIGN, NOISE = 0, 7, 24, 3, 48, 80, 84, 68  # of the set
STEP = 5  # of a load


def without_control(i: int) -> Case:
    """A case of the set, without controllers."""
    case: Case = case_of(SET, (), i)
    return case


def index(i: int, name: str | None) -> float:
    """The index of a controller of the set, or of none, in a case."""
    rows = SET.content.controllers[name] if name else ()
    value = measure(case_of(SET, rows, i), AFTER, 0)[0].measure
    assert value is not None
    return value


@cache
def of_reference(i: int, *, delayed: bool) -> float:
    """The index of the reference in a case."""
    value = reference(without_control(i), AFTER, delayed=delayed).measure
    assert value is not None
    return value


def plain(system: str, **fields: Any) -> Case:
    """A run without noise, delays and controllers."""
    run = {"system": system, "scenario": [], "controllers": [], "duration": 8.0, **fields}
    return changed_case(run, "test", {})


DISTURBANCE = [
    {"kind": "load_step", "load": "load_1", "time": 0.5, "change": 0.001},
    {"kind": "load_step", "load": "load_1", "time": 0.6, "change": 0.0},
]


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_poles_of_the_closed_loop_are_those_of_linear_theory(delay: float) -> None:
    """Riccati's equation of SciPy for all states of the plant, against a free swing of the nonlinear plant.

    With the delay predicted over, the poles are the same (and others at z = 0). Without control the damping ratio of
    the interarea mode is 1.0 %.
    """
    case, weight = plain("two_area", devices=["sssc"]), 1e-5
    rate, limit = case.run.frame_rate, case.system.device("sssc").setpoint_max
    built = build_plant(case)
    names, (A, B) = built.state_names, linearise(built)
    n, common = len(A), np.array([float(name.endswith(".delta")) for name in names])
    still = np.eye(n) - np.outer(common, common) / common.sum()  # no common turn of all rotors
    moved = expm(np.block([[A, B], [np.zeros((1, n + 1))]]) / rate)
    Phi, Gamma = still @ moved[:n, :n] @ still, moved[:n, n:] * limit
    speed = {rotor: np.array([float(name == f"{rotor}.omega") for name in names]) for rotor in ("G1", "G2", "G3", "G4")}
    Z = np.array([speed[a] - speed[b] for a, b in (("G1", "G2"), ("G3", "G4"), ("G1", "G3"))])
    X = solve_discrete_are(Phi, Gamma, Z.T @ Z / weight + 1e-12 * np.eye(n), np.eye(1))
    closed = Phi - Gamma @ np.linalg.solve(np.eye(1) + Gamma.T @ X @ Gamma, Gamma.T @ X @ Phi)
    poles = np.log(np.linalg.eigvals(closed).astype(complex) + 1e-30) * rate
    expected = min(poles, key=lambda pole: abs(pole - (-0.7 + 4j)))

    swung = replace(case, scenario=Scenario.model_validate({"name": "pulse", "events": DISTURBANCE}))
    run = upper.run(swung, [law(model, swung, delay, weight) for model in swing_models(swung)], delay)
    assert np.abs(run.devices["setpoint"]).max() < limit
    w13 = speed_differences(run)["w13"][round(1.5 * rate) : round(5.0 * rate)]
    pole = min(_fitted_poles(w13, rate), key=lambda value: abs(value - expected))
    assert pole == pytest.approx(expected, abs=0.02)
    assert -expected.real / abs(expected) > 0.15


def _fitted_poles(signal: np.ndarray[Any, Any], rate: int, order: int = 6, every: int = 6) -> np.ndarray[Any, Any]:
    """Poles of a free response by linear prediction with least squares (Prony)."""
    x = signal[::every]
    rows = np.array([x[i : i + order] for i in range(len(x) - order)])
    weights = np.linalg.lstsq(rows, -x[order:], rcond=1e-10)[0]
    roots = np.roots([1.0, *weights[::-1]]).astype(complex)
    poles: np.ndarray[Any, Any] = np.log(roots) * rate / every
    return poles


def test_law_without_delay_is_that_with_a_delay_of_zero_frames() -> None:
    case = without_control(STEP)
    model = swing_models(case)[0]
    Phi, steps = onward(model, case.run.frame_rate, [0.0])
    assert len(steps) == 1
    rate = case.run.frame_rate
    Phi_late, late = onward(model, rate, [2.5 / rate])
    assert (Phi_late == Phi).all()
    assert [bool(step.any()) for step in late] == [False, False, True, True]
    assert late[2] + late[3] == pytest.approx(steps[0], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("i", [TRIP, 1, 2, STEP, CLEARED])
def test_reference_has_no_more_of_the_index_than_lqg_in_nominal_cases(i: int) -> None:
    """Nor has it with the delay of the case; without control it has much more."""
    lqg = index(i, "LQG")
    assert of_reference(i, delayed=False) < lqg
    assert of_reference(i, delayed=True) < lqg
    assert of_reference(i, delayed=False) < 0.42 * index(i, None)


def test_governor_whose_rate_is_limited_at_first_does_not_mislead_the_reference() -> None:
    """The step of a mechanical power is so large; the state without swings is where the run ends."""
    case = without_control(LIMITED)
    before, after = swing_models(case)
    assert np.abs(after.at - before.at).max() < 5.0  # p.u. or rad: not carried away at the limit of the rate
    assert of_reference(LIMITED, delayed=True) < 0.4 * index(LIMITED, None)


def test_reference_knows_the_plant_that_a_controller_was_not_designed_on() -> None:
    assert of_reference(WRONG_MODEL, delayed=False) < index(WRONG_MODEL, "LQG")
    model = replace(without_control(WRONG_MODEL), model=None)
    assert reference(model, AFTER, delayed=False).measure == of_reference(WRONG_MODEL, delayed=False)


def test_delay_makes_the_reference_no_better() -> None:
    """By a mean over cases: K is optimal for squares, the index is ITAE, so in a single small case it may be."""
    cases = [TRIP, STEP, CLEARED, SLOW]
    ratios = [np.log(of_reference(i, delayed=True) / of_reference(i, delayed=False)) for i in cases]
    assert mean_loop_delay(without_control(SLOW)) > 0.4
    assert np.mean(ratios) > 0.05
    assert ratios[0] > 0.2  # the swing after a fault has begun when it acts


def test_limits_and_rates_of_the_device_hold() -> None:
    case = without_control(TRIP)
    device = case.system.device("sssc")
    laws = [law(model, case, 0.0, upper.CONTROL_WEIGHTS[0]) for model in swing_models(case)]
    run = upper.run(case, laws, 0.0)
    setpoint, position = run.devices["setpoint"][:, 0], run.devices["reference"][:, 0]
    assert np.abs(setpoint).max() == pytest.approx(device.setpoint_max)
    assert np.abs(np.diff(position)).max() * case.run.frame_rate <= device.rate_max * (1.0 + 1e-9)
    figures = reference(case, AFTER, delayed=False)
    assert 0.0 < figures.saturated < 0.2
    assert 0.0 < figures.effort < 0.5


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_reference_does_not_know_the_event_before_it_happens(delay: float) -> None:
    """With a delay it acts on it no earlier than that."""
    case = without_control(STEP)
    laws = [law(model, case, delay, upper.CONTROL_WEIGHTS[0]) for model in swing_models(case)]
    assert len(laws) == 2
    run, quiet = upper.run(case, laws, delay), upper.run(without_events(case), laws[:1], delay)
    differ = np.flatnonzero(run.devices["setpoint"][:, 0] != quiet.devices["setpoint"][:, 0])
    first = run.time_s[differ[0]]
    assert case.scenario.events[0].time + delay <= first <= case.scenario.events[0].time + delay + 0.06


def test_simulation_over_the_delay_predicts_a_small_swing_as_the_linear_model(monkeypatch: pytest.MonkeyPatch) -> None:
    """And a large one otherwise: after a fault and a trip of the tie."""

    def setpoints(case: Case, large: float) -> np.ndarray[Any, Any]:
        monkeypatch.setattr(upper, "LARGE", large)
        run = upper.run(case, [law(model, case, 0.21, 1e-6) for model in swing_models(case)], 0.21)
        values: np.ndarray[Any, Any] = run.devices["setpoint"][:, 0]
        return values

    small = plain("two_area", devices=["sssc"])
    small = replace(small, scenario=Scenario.model_validate({"name": "pulse", "events": DISTURBANCE}))
    for case, alike in ((small, True), (without_control(TRIP), False)):
        linear, simulated = setpoints(case, np.inf), setpoints(case, 0.0)
        differ = np.abs(linear - simulated).max() / np.abs(linear).max()
        assert (differ < 0.02) == alike
        assert differ > 0.0


@pytest.mark.parametrize("i", [LOST_DEVICE, WRONG_SIGN])
def test_fault_of_a_link_does_not_reach_the_reference(i: int) -> None:
    faulted = without_control(i)
    sound = replace(faulted, link=faulted.link.model_copy(update={"down": faulted.link.down[:-1]}), links=[])
    sound = replace(sound, links=[sound.link])
    assert len(sound.link.down) == len(faulted.link.down) - 1
    assert reference(sound, AFTER, delayed=True).measure == of_reference(i, delayed=True)
    assert of_reference(i, delayed=True) < 0.5 * index(i, None)


def test_reference_reduces_the_swings_of_noise() -> None:
    assert of_reference(NOISE, delayed=False) < 0.9 * index(NOISE, None)


def test_controllers_and_supervision_of_a_case_do_not_count() -> None:
    with_lqg = case_of(SET, SET.content.controllers["LQG"], STEP)
    assert reference(with_lqg, AFTER, delayed=False).measure == of_reference(STEP, delayed=False)


def test_control_weight_trades_effort_for_the_index() -> None:
    case = without_control(STEP)
    cheap = reference(case, AFTER, delayed=False)
    dear = reference(case, AFTER, delayed=False, control_weights=[1e-4])
    assert cheap.measure is not None
    assert dear.measure is not None
    assert dear.measure > 1.5 * cheap.measure
    assert dear.effort < 0.5 * cheap.effort


@pytest.mark.parametrize(
    ("run", "most"),
    [("minniwecc", 0.65), ("two_area_ibr_pod", 0.2), ("two_area_hvdc", 0.1), ("iberia_swing", 0.5)],
)
def test_reference_works_with_other_grids_and_devices(run: str, most: float) -> None:
    """A DC line of a large grid, the input of an inverter's plant, an HVDC link; index relative to no control."""
    case = load_case(run, ["duration=12"])
    none = measure(replace(case, controllers=[], supervision=None), 8.0, 0)[0].measure
    figures = reference(case, 8.0, delayed=True)
    assert figures.measure is not None
    assert none is not None
    assert figures.measure < most * none


def test_frequency_of_a_pmu_without_a_rotor_counts_in_the_law() -> None:
    """At the terminals of a machine it is nearly the speed of its rotor."""
    case = plain("two_area", devices=["sssc"])
    terminal = {"name": "AT_G3", "bus": next(machine.bus for machine in case.system.machines if machine.name == "G3")}
    content = case.document()
    system = content["system"]
    system["pmus"] = [*system["pmus"], terminal]
    system["signals"] |= {"across": {"channel": "frequency", "weights": {"G1": 1.0, "AT_G3": -1.0}}}
    system["measures"] = {"interarea": ["across", "w13"]}
    model = swing_models(changed_case({**content, "asked": None}, "test", {}))[0]
    values, vectors = np.linalg.eig(model.A)
    mode = vectors[:, np.argmin(np.abs(values - 4j))]
    across, w13 = model.Z @ mode
    assert across / w13 == pytest.approx(1.0, abs=0.2)
