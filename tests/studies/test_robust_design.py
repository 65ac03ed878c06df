"""Laws for all scenarios of a grid: plants, gradients and minima against other derivations, and the whole path."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from facts_damping.case.loading import load_case
from facts_damping.cli.main import main
from facts_damping.control.linear_law import Matrices
from facts_damping.plant.build import build
from facts_damping.small_signal.linearisation import linear_model, state_matrix
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled
from facts_damping_studies.robust import (
    certificate,
    laws,
    loops,
    modal_plants,
    nonsmooth,
    objective,
    plants,
    structures,
)
from facts_damping_studies.robust import scenarios as grids
from facts_damping_studies.robust.robust_design import independent, law_row
from facts_damping_studies.robust.tuning import opposed, tuned
from facts_damping_studies.score.cases.drawing import meshed_lines

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.case.model import Case
    from facts_damping.parameters.plant.system import System

SIGNALS = ["frequency", "f13"]
DELAYS = [0.1, 0.2]


def quiet(_name: str, _what: str) -> Any:
    return lambda _done, _of: None


@pytest.fixture(scope="module")
def case() -> Case:
    return load_case("two_area_deployment", ["controllers=[]", "scenario=[]"])


@pytest.fixture(scope="module")
def known(case: Case) -> grids.Scenarios:
    return grids.scenarios(case, SIGNALS, 3, 2, 1, quiet)


@pytest.fixture(scope="module")
def problem(case: Case, known: grids.Scenarios) -> objective.Problem:
    device = case.system.device("sssc")
    setting = laws.Setting(np.array([device.setpoint_max]), np.array([0.035]), np.full(2, 2e-5), 60)
    return laws.problem(known.all, setting, DELAYS, laws.sizes(known.all[0]))


@pytest.fixture
def inside(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run the command within the test: status, standard output and error."""

    def run(*arguments: str) -> tuple[int, str, str]:
        status = main(list(arguments))
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return run


def random_law(random: np.random.Generator, states: int, devices: int, signals: int) -> np.ndarray[Any, Any]:
    K = random.normal(size=(states + devices, states + signals))
    K[:states, :states] -= 6.0 * np.eye(states)
    K[states:] *= 0.02
    K[states:, states:] = 0.0
    return K


def test_modal_plant_has_the_transfer_functions_of_the_whole_plant(case: Case, known: grids.Scenarios) -> None:
    built = build(case.system, case.run.devices, [])
    chosen = {name: case.system.signals[name] for name in SIGNALS}
    whole = linear_model(built, chosen, [pmu.name for pmu in case.system.pmus])._replace(washout=np.zeros(2))
    plant = known.all[0].modal
    A, B, C, *_ = plant.real()
    at = 2j * np.pi * np.array([0.2, 0.55, 1.1, 2.0])
    exact_ones = [whole.response(s) / whole.late(s) for s in at]
    largest = np.abs(exact_ones).max()
    for s, exact in zip(at, exact_ones, strict=True):
        assert np.abs(plant.response(s) - exact).max() < 0.01 * largest
        real = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + plant.D
        assert np.allclose(real, plant.response(s), rtol=1e-8, atol=1e-12)


def test_reduced_plant_is_within_its_bound(case: Case, known: grids.Scenarios) -> None:
    """The bound is of scaled signals and setpoints; differences of speeds and torques only add to it."""
    limits = np.array([case.system.device("sssc").setpoint_max])
    for each in known.all:
        size = np.abs(each.modal.response(2j * np.pi * 0.5)).max(axis=1)
        A, B, C, D, *_ = each.plant
        for hertz in (0.1, 0.3, 0.6, 1.2, 3.0):
            s = 2j * np.pi * hertz
            small = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
            assert (np.abs(small - each.modal.response(s)) / size[:, None] * limits).max() <= each.plant.bound * 1.01


@settings(max_examples=20)
@given(seed=st.integers(0, 10**6))
def test_gradients_are_those_of_differences(problem: objective.Problem, seed: int) -> None:
    random = np.random.default_rng(seed)
    K = random_law(random, 3, 1, 2)
    structure = structures.free("free", K, 3)
    for parameters in (structure.start, structure.weaker(structure.start, 0.1)):
        value, gradient = objective.objective(problem, structure, parameters)
        if not np.isfinite(value):
            continue
        step = 1e-6 * random.normal(size=len(parameters))
        up, down = (objective.objective(problem, structure, parameters + sign * step)[0] for sign in (1.0, -1.0))
        if np.isfinite(up + down) and abs(up + down - 2.0 * value) < 1e-3 * abs(up - down):  # no kink between
            assert (up - down) / 2.0 == pytest.approx(gradient @ step, rel=2e-3, abs=1e-10)


def test_index_is_the_integral_of_a_response(problem: objective.Problem) -> None:
    """ITSE of the speed differences after steps of torques, by small steps of time."""
    each = problem.loops[0]._replace(effort=0.0)
    K = random_law(np.random.default_rng(3), 2, 1, 2)
    A, _, _ = loops.closed(each, K, 2)
    step = 0.002
    onward = expm(A * step)
    x = np.vstack([each.R, np.zeros((2, each.R.shape[1]))])
    total = 0.0
    for k in range(40000):
        total += step * (k + 0.5) * step * float(((each.Z @ x[: len(each.A)]) ** 2).sum())
        x = onward @ x
    change = loops.value(each, K, 2).log_ratio
    assert change == pytest.approx(0.5 * np.log(total / each.index_without), abs=0.01)


def test_delay_terms_turn_the_phase_of_a_delay() -> None:
    A, B, C = loops.delay_terms([0.15, 0.3])
    for hertz in (0.2, 0.6, 1.2):
        s = 2j * np.pi * hertz
        assert np.allclose(
            np.diag(C @ np.linalg.solve(s * np.eye(6) - A, B)), np.exp(-s * np.array([0.15, 0.3])), atol=0.05
        )


@settings(max_examples=15)
@given(x=st.floats(-2.0, 2.0), y=st.floats(-2.0, 2.0))
def test_minimum_of_a_function_with_a_kink_is_found(x: float, y: float) -> None:
    """Rosenbrock's valley with a kink along its floor: 8 |x^2 - y| + (1 - x)^2, least at (1, 1)."""

    def valley(at: Any) -> tuple[float, Any]:
        side = np.sign(at[0] ** 2 - at[1])
        value = 8.0 * abs(at[0] ** 2 - at[1]) + (1.0 - at[0]) ** 2
        return value, np.array([16.0 * side * at[0] - 2.0 * (1.0 - at[0]), -8.0 * side])

    least = nonsmooth.minimum(valley, np.array([x, y]), 4000, np.random.default_rng(1), lambda _n: None)
    assert least.value < 0.05


def test_shortest_vector_of_a_hull() -> None:
    assert np.allclose(nonsmooth.shortest(np.array([[1.0, 2.0], [1.0, -1.0]])), [1.0, 0.0], atol=1e-6)
    assert np.linalg.norm(nonsmooth.shortest(np.array([[1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]]))) < 1e-6


def test_lead_lags_are_their_transfer_functions() -> None:
    channels = [structures.Channel(0, 1, 2.3, 0.3, 0.1), structures.Channel(1, 0, -1.3, 0.1, 0.25)]
    law = structures.lead_lags(channels, 2, 3)
    K, n, s = law.matrix(law.start), law.states, 2j * np.pi * 0.6
    response = K[n:, :n] @ np.linalg.solve(s * np.eye(n) - K[:n, :n], K[:n, n:]) + K[n:, n:]
    for each in channels:
        section = (1.0 + s * each.T1) / (1.0 + s * each.T2)
        expected = each.gain * 10.0 * s / (1.0 + 10.0 * s) * section**2
        assert response[each.device, each.signal] == pytest.approx(expected)
    assert np.count_nonzero(np.abs(response) > 1e-12) == 2
    assert np.allclose(structures.channels_of(law.start, channels), channels)


def test_outages_are_in_the_order_in_which_they_move_modes(case: Case) -> None:
    """The first by the estimate moves the eigenvalues of the plants themselves nearly as far as any."""
    lines = meshed_lines(case.system)

    def swings(system: System) -> Any:
        matrix, _ = state_matrix(build(system, case.run.devices, [], sparse=True))
        return modal_plants.vectors(matrix)

    near = swings(case.system)
    estimated = grids.worst(case, lines, near, lambda _done, _of: None)
    values = grids.swinging(near).values

    def distance(line: str) -> float:
        other = grids.swinging(swings(grids.without(case.system, line))).values
        return float(sum(np.abs(other - value).min() / abs(value) for value in values))

    distances = [distance(line) for line in estimated]
    assert distances[0] > 0.7 * max(distances)


def test_certificate_is_that_of_the_whole_sampled_loop(case: Case, known: grids.Scenarios) -> None:
    """The modes of `margin`'s loop, of all states, with the run's own controller."""
    A, B = np.array([[-2.0, 1.0], [0.0, -3.0]]), np.array([[4.0, 0.0], [3.0, 5.0]])
    law = certificate.Law(Matrices(A, B, np.array([[-3.0, -2.0]]), np.zeros((1, 2))), [0, 1], [0], 60)
    run = load_case("two_area_deployment", [f"controllers={json.dumps([law_row(law, SIGNALS, ['sssc'])])}"])
    whole = delayed_loop(run)
    row = certificate.rows([known.all[0]], law, [0.15])[0]
    ratio, hertz = certificate.least_damped(eigen(whole, sampled(whole, 0.15)).values)
    assert row.damping == pytest.approx(ratio, abs=5e-4)
    assert row.hertz == pytest.approx(hertz, abs=0.005)


def test_tuned_law_keeps_its_demands_in_every_scenario(problem: objective.Problem, known: grids.Scenarios) -> None:
    setting = laws.Setting(np.array([0.1]), np.array([0.035]), np.full(2, 2e-5), 60)
    law = laws.starts(problem, known.all[0], setting, 0.1, laws.sizes(known.all[0]), ["LQG"])[0]
    result = tuned(problem, law, 60, 1, lambda _done, _of: None)
    assert result.judged.log_ratio < -0.1
    values = result.judged.values
    assert max(value.log_ratio for value in values) < 0.02
    for each, value in zip(problem.loops, values, strict=True):
        assert each.damping + value.damping > min(each.damping, objective.ENOUGH) - objective.LOST - 2e-3


def test_scenario_with_a_device_the_other_way_round_is_named(
    problem: objective.Problem, known: grids.Scenarios
) -> None:
    """The same plant with the device's sign changed: no law of one sign damps both."""
    setting = laws.Setting(np.array([0.1]), np.array([0.035]), np.full(2, 2e-5), 60)
    law = laws.starts(problem, known.all[0], setting, 0.1, laws.sizes(known.all[0]), ["lead-lag"])[0]
    intact = problem.of([i for i, name in enumerate(problem.scenarios) if name == grids.INTACT])
    turned = intact.inverted({grids.INTACT: [0]})
    both = intact._replace(
        scenarios=[*intact.scenarios, *["turned"] * len(turned.loops)],
        loops=[*intact.loops, *turned.loops],
        responses=np.concatenate([intact.responses, turned.responses]),
    )
    assert opposed(intact, law.matrix(law.start), law.states) == {}
    assert opposed(both, law.matrix(law.start), law.states) == {"turned": [0]}


def test_signals_that_say_the_same_are_left_out(case: Case) -> None:
    names = ["frequency", "f12", "f34", "f13"]
    plant = grids.scenarios(case, names, 0, 0, 1, quiet).all[0]
    rows = independent(plant, len(names))
    twice = plant.modal.of_signals([*rows, rows[0]])
    assert len(independent(plant._replace(modal=twice), len(rows) + 1)) == len(rows)


def test_command_designs_a_run_that_others_take(inside: Callable[..., tuple[int, str, str]], tmp_path: Path) -> None:
    """From the grid to a certificate, a picture and a run, which is then simulated and has a margin."""
    folder = tmp_path / "designed"
    command = [
        "design",
        "two_area",
        "--profile",
        "deployment",
        "--place",
        "sssc",
        "--outages",
        "2",
        "--law",
        "lead-lag",
    ]
    status, text, _ = inside(*command, "--jobs", "1", "--out", str(folder))
    assert status == 0
    assert "certificate of" in text
    assert "delay to" in text
    assert {path.name for path in folder.iterdir()} == {"run.yaml", "damping.png", "result.json"}
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    assert min(row["damping"] for row in result["scenarios"]) > 0.0
    run = str(folder / "run.yaml")
    assert inside("margin", run, "--set", "supervision=null")[0] == 0
    case_of_run = load_case(run, ["duration=1"])
    assert [row.name for row in case_of_run.controllers] == ["designed"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["two_area", "--law", "PID"], "--law: 'PID' given; allowed: best, lead-lag, LQG, Hinf, residue"),
        (
            ["two_area", "--place", "sssc,B9"],
            "--place: sssc,B9 given; allowed: devices of the grid (sssc, statcom), or",
        ),
        (["two_area", "--signal", "power", "--place", "sssc"], "signals: power (active_power) given; allowed: speed"),
        (["two_area", "--signal", "none", "--place", "sssc"], "--signal: 'none' given; allowed: "),
    ],
)
def test_bad_input_is_one_line(inside: Callable[..., tuple[int, str, str]], arguments: list[str], named: str) -> None:
    status, _, error = inside("design", *arguments)
    assert status != 0
    assert named in error
    assert len(error.strip().splitlines()) == 1


def test_band_is_where_modes_are_judged() -> None:
    values = np.array([-0.1 + 1j * 2.0 * np.pi * hertz for hertz in (0.05, 0.5, 3.0)])
    ratio, hertz = certificate.least_damped(values)
    assert hertz == pytest.approx(0.5)
    assert ratio == pytest.approx(0.1 / abs(values[1]))
    assert modal_plants.BAND_HZ == (0.1, 2.5)
    assert plants.KEPT < 0.01
