"""The design of the LQG: stable with the whole plant, optimal, of a model that is near it; and what is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from control import dlqr
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import cont2discrete

from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from facts_damping.simulation.assembly import build_control, plant_residues
from facts_damping.small_signal.lqg import DesignModel, design, model, optimal, reduced, sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.control.state_space import StateSpace
    from facts_damping.small_signal.residues import Residues

LQG = ["controllers.0.name=LQG"]
BOTH = ["devices=[sssc, statcom]", "controllers.0.devices=[sssc, statcom]"]
RUNS = {
    "two_area": LQG,
    "two_area, w13": [*LQG, "controllers.0.signals=[w13]"],
    "two_area, STATCOM": [*LQG, "devices=[statcom]", "controllers.0.devices=[statcom]"],
    "two_area, both": [*LQG, *BOTH, "controllers.0.signals=[speed, power]"],
    "two_area, four signals": [*LQG, *BOTH, "controllers.0.signals=[w12, w34, w13, voltage]"],
    "smib": [*LQG, "system=smib", "scenario=nominal"],
    "smib, heavy": [*LQG, "system=smib", "scenario=heavy"],
}
ORDERS = {"two_area": 11, "two_area, both": 13, "smib": 4}  # of the reduced models
PARTS = 4  # of a frame, in which delays are counted here


def case_of(which: str, quarters: int = 0) -> Case:
    return load_case(None, [*RUNS[which], f"link.up=[{{delay: {quarters / PARTS / 60!r}}}]"])


def plant_of(case: Case) -> Residues:
    plant = plant_residues(case)
    assert plant is not None
    return plant


def matrices(case: Case) -> StateSpace:
    return design(plant_of(case), case.system, case.controllers[0], "controllers.0")


class Whole(NamedTuple):
    """The full linear plant from a quarter of a frame to the next, as SciPy samples it."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    D: NDArray[np.float64]
    washout: NDArray[np.float64]
    names: list[str]


def whole_of(case: Case) -> Whole:
    plant, (controller,) = plant_of(case), case.controllers
    rows = [plant.signals.index(name) for name in controller.signals]
    columns = [plant.devices.index(name) for name in controller.devices]
    linear = plant.model
    C, D = linear.C[rows], linear.D[np.ix_(rows, columns)]
    A, B, *_ = cont2discrete((linear.A, linear.B[:, columns], C, D), 1.0 / 60 / PARTS)
    return Whole(A, B, C, D, linear.washout[rows], plant.names)


def frame(
    whole: Whole, observer: StateSpace, quarters: int, state: list[NDArray[np.float64]]
) -> list[NDArray[np.float64]]:
    """A frame of plant and controller: what each part of the state becomes; each has a column a start.

    Parts are the plant, raw and washed signals of the frame before, estimate, setpoint, what is in force, and what is
    on its way, a quarter of a frame each.
    """
    x, raw, washed, estimate, u, force, *sent = state
    now = whole.C @ x + whole.D @ force
    a = 2 * 60 * whole.washout[:, None]
    y = np.where(a > 0, (a * (now - raw) - (1 - a) * washed) / (1 + a), now)
    estimate = observer.A @ estimate + observer.B @ u
    estimate = estimate + observer.M @ (y - observer.C @ estimate)
    u = -observer.K @ estimate
    for _ in range(PARTS):
        sent = [*sent, u]
        force, *sent = sent
        x = whole.A @ x + whole.B @ force
    assert len(sent) == quarters
    return [x, now, y, estimate, u, force, *sent]


def closed(whole: Whole, observer: StateSpace, quarters: int) -> NDArray[np.float64]:
    """The closed loop from frame to frame, a column for each part of the state."""
    signals, devices = whole.D.shape
    sizes = [len(whole.A), signals, signals, len(observer.A), *[devices] * (2 + quarters)]
    parts = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])
    return np.vstack(frame(whole, observer, quarters, parts))


def unanswered(whole: Whole, matrix: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Eigenvalues, and how far each one's motion is from all rotors turning or speeding up alike."""
    values, vectors = np.linalg.eig(matrix)
    for end in (".delta", ".omega"):
        motion = np.array([name.endswith(end) for name in whole.names])
        vectors[: len(motion)][motion] -= vectors[: len(motion)][motion].mean(axis=0)
    return values, np.linalg.norm(vectors, axis=0)


@pytest.mark.parametrize("quarters", [0, 1, 4, 22])
@pytest.mark.parametrize("which", RUNS)
def test_with_the_whole_plant_all_that_is_seen_and_moved_is_stable(which: str, quarters: int) -> None:
    case = case_of(which, quarters)
    whole, observer = whole_of(case), matrices(case)
    values, others = unanswered(whole, closed(whole, observer, quarters))
    rigid = 0 if which.startswith("smib") else 2
    assert np.sum(others < 1e-3) == rigid  # two motions of an island, none beside an infinite bus
    assert np.abs(values[others >= 1e-3]).max() < 1.0
    quiet = observer._replace(K=0.0 * observer.K)
    values, others = unanswered(whole, closed(whole, quiet, quarters))
    assert (np.abs(values[others >= 1e-3]).max() > 1.0) == (which != "smib")


@pytest.mark.parametrize("which", ORDERS)
def test_reduced_model_is_near_the_plant_and_small(which: str) -> None:
    """Answers at 0.05 to 3 Hz to setpoints and torques, within 3 % of the largest of each signal."""
    case = case_of(which)
    plant, (controller,) = plant_of(case), case.controllers
    whole = model(plant, case.system, controller)
    small = reduced_of(case)
    assert len(small.A) == ORDERS[which]
    s = 2j * np.pi * np.geomspace(0.05, 3.0, 60)
    for B, b in ((whole.B, small.B), (whole.G, small.G)):
        for C, c in ((whole.C, small.C), (whole.Z, small.Z)):
            full = np.array([C @ np.linalg.solve(frequency * np.eye(len(whole.A)) - whole.A, B) for frequency in s])
            less = np.array([c @ np.linalg.solve(frequency * np.eye(len(small.A)) - small.A, b) for frequency in s])
            maximum = np.abs(full).max(axis=(0, 2))[:, None]
            assert (np.abs(less - full).max(axis=0) < 0.03 * maximum).all()


def reduced_of(case: Case) -> DesignModel:
    plant, (controller,) = plant_of(case), case.controllers
    whole = model(plant, case.system, controller)
    size = np.abs([plant.ratio(name, controller.signals[0]) for name in controller.signals])
    size *= np.linalg.norm(plant.model.C[plant.signals.index(controller.signals[0])] @ plant.shape)
    limits = np.array([case.system.device(name).setpoint_max for name in controller.devices])
    return reduced(whole, plant.names, limits, size / np.linalg.norm(whole.Z @ plant.shape))


@pytest.mark.parametrize("lag", [0.0, 0.004, 0.1, 0.21])
@pytest.mark.parametrize("which", ["two_area, both", "smib"])
def test_regulator_is_riccatis_of_the_plant_with_its_delay(which: str, lag: float) -> None:
    """Its prediction makes what one large Riccati equation does, with every setpoint on its way a state."""
    case = case_of(which)
    small, limits = reduced_of(case), np.array([0.1] * len(case.controllers[0].devices))
    step = sampled(small, 60, lag)
    washout, noise = np.zeros(len(small.C)), np.ones(len(small.C))
    observer = optimal(small, step, None, washout, 1 / 60, limits, 1e-6, noise)
    Q = np.zeros((len(observer.A), len(observer.A)))
    Q[: len(small.A), : len(small.A)] = small.Z.T @ small.Z
    K, *_ = dlqr(observer.A, observer.B, Q, np.diag(1e-6 / limits**2), method="scipy")
    assert len(observer.A) == len(small.A) + (int(60 * lag) + 1) * len(limits)
    np.testing.assert_allclose(observer.K, K, rtol=1e-4, atol=1e-5 * np.abs(K).max())


@pytest.mark.parametrize("lag", [0.0, 0.06])
@pytest.mark.parametrize("which", ["two_area", "two_area, both", "smib, heavy"])
def test_lqg_gains_have_the_least_cost(which: str, lag: float) -> None:
    """Mean cost of the loop with steps of torque and noise, by Lyapunov's equation."""
    case = case_of(which)
    plant, (controller,) = plant_of(case), case.controllers
    small, limits = reduced_of(case), np.array([0.1] * len(controller.devices))
    washout = plant.model.washout[[plant.signals.index(name) for name in controller.signals]]
    noise = 0.1 * np.abs([plant.ratio(name, controller.signals[0]) for name in controller.signals])
    observer = optimal(small, sampled(small, 60, lag), None, washout, 1 / 60, limits, 1e-5, noise)
    torque = np.zeros((len(observer.A), small.G.shape[1]))  # a jump away from where each step leads
    jump = np.linalg.solve(small.A, small.G)
    torque[: len(jump)] = jump
    torque[len(jump) : len(jump) + np.sum(washout > 0)] = (small.C @ jump)[washout > 0]

    def cost(trial: StateSpace) -> float:
        """Of states X and x(k|k-1)."""
        back = trial.A - trial.B @ trial.K @ (np.eye(len(trial.A)) - trial.M @ trial.C)
        feed = trial.B @ trial.K @ trial.M
        seen = trial.A @ trial.M @ trial.C
        top = np.hstack([trial.A - feed @ trial.C, -trial.B @ trial.K @ (np.eye(len(trial.A)) - trial.M @ trial.C)])
        low = np.hstack([seen - feed @ trial.C, back - seen])
        loop_ = np.vstack([top, low])
        of_noise = np.vstack([-feed, trial.A @ trial.M - feed]) * noise
        of_torque = np.vstack([torque, np.zeros_like(torque)])
        V = solve_discrete_lyapunov(loop_, of_noise @ of_noise.T + of_torque @ of_torque.T)
        n = len(trial.A)
        Z = np.hstack([small.Z, np.zeros((len(small.Z), 2 * n - len(small.A)))])
        u = -trial.K @ np.hstack([trial.M @ trial.C, np.eye(n) - trial.M @ trial.C])
        of_u = u @ V @ u.T + trial.K @ trial.M @ np.diag(noise**2) @ trial.M.T @ trial.K.T
        assert np.abs(np.linalg.eigvals(loop_)).max() < 1.0
        return float(np.trace(Z @ V @ Z.T) + 1e-5 * np.sum(np.diag(of_u) / limits**2))

    minimum, random = cost(observer), np.random.default_rng(1)
    dearer = []
    for _ in range(10):
        K = observer.K * (1 + 0.02 * random.normal(size=observer.K.shape))
        M = observer.M * (1 + 0.02 * random.normal(size=observer.M.shape))
        dearer += [cost(observer._replace(K=K)) / minimum - 1.0, cost(observer._replace(M=M)) / minimum - 1.0]
    assert min(dearer) > 0.0
    assert max(dearer) < 0.1  # near an optimum the cost is flat


@pytest.mark.parametrize("which", ["two_area", "two_area, both"])
def test_against_a_changed_plant_no_setpoint_is_held(which: str) -> None:
    """With a line out for good the plant rests at other angles."""
    case = load_case(None, [*RUNS[which], "scenario=[{time: 1, kind: line_out, line: line_3}]", "duration=40"])
    record = loop.run(case)
    setpoints = np.abs(record.devices["setpoint"])
    assert setpoints[60:300].max() > 0.01
    assert setpoints[-300:].max() < 1e-3
    assert np.ptp(record.frames[-1, :4, 2]) < 1e-5  # the machines' speeds


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["controllers.0.scheme=direct"], r"controllers.0.scheme: 'direct' given; allowed: none for LQG"),
        (["controllers.0.compensation=lead"], r"controllers.0.compensation: 'lead' given; allowed: none for LQG"),
        (["controllers.0.compensation=prediction"], r"'prediction' given; allowed: none for LQG"),
        (["controllers.0.parameters.gain=1"], r"'gain' given; allowed: control_weight, measurement_noise, loop_delay"),
        (
            ["controllers.0.parameters.measurement_noise=[0.1, 0.1]"],
            r"noise: 2 numbers given; allowed: a number, or 1, one a signal",
        ),
        (
            ["controllers.0.signals=[w]", "system.signals.w={channel: active_power, weights: {TIE: 1}}"],
            r"controllers.0.signals.0: 'w' given, which is not zero in the steady state; allowed: for LQG speed dev",
        ),
        (
            ["controllers.0.signals=[w]", "system.signals.w={channel: speed_deviation, weights: {G1: 1}}"],
            r"controllers.0.signals: w given, which contain the rotors' common motion, .*; allowed: for LQG",
        ),
        (
            ["system=smib", "scenario=nominal", "controllers.0.signals=[power]"],
            r"signals.0: 'power' given, which is not zero",
        ),
    ],
)
def test_invalid_lqg_is_refused_in_one_line(sets: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message) as raised:
        build_control(load_case(None, [*LQG, *sets]))
    assert "\n" not in str(raised.value)


def test_plant_that_does_not_swing_is_refused() -> None:
    case = case_of("smib")
    with pytest.raises(
        InputError, match=r"controllers.0.name: 'LQG' given, but the plant has no electromechanical mode; allowed: LLC"
    ):
        design(None, case.system, case.controllers[0], "controllers.0")
