"""The observer that predicts by the measured age: exact motion, prediction, matrices, LQG, hypotheses of actuators."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.linalg import expm

import facts_damping as fd
from facts_damping.case.loading import load_case
from facts_damping.errors import InputError
from facts_damping.link.stages import mean_delay
from facts_damping.simulation.assembly import plant_residues
from facts_damping.small_signal.lqg import DesignModel
from facts_damping_studies.laws.actuator_tests import decided, ratios, with_innovations, without_evidence
from facts_damping_studies.laws.age_observer import AgeObserver
from facts_damping_studies.laws.from_lqg import Criterion, from_lqg, modal, observer_law, washed
from facts_damping_studies.laws.observer_law import (
    ObserverLaw,
    Sent,
    from_parameters,
    in_force,
    innovation,
    sampled_law,
    to_parameters,
    turned,
)
from facts_damping_studies.margins.linear_closed_loop import Discrete, delayed_loop, eigen, sampled

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

POLICY = "facts_damping_studies.laws.age_observer:AgeObserver"
SEEDS = range(5)
RATE = 60


def plant_of(random: np.random.Generator, n: int = 6, devices: int = 2, signals: int = 2) -> DesignModel:
    A = random.normal(size=(n, n)) * 2.0
    A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(n)
    shapes = ((n, devices), (n, 3), (signals, n), (signals, devices), (2, n))
    return DesignModel(A, *(random.normal(size=shape) for shape in shapes))


def law_of(random: np.random.Generator, **fields: Any) -> ObserverLaw:
    criterion = Criterion(np.array([0.5, 2.0]), 0.1, np.array([0.1, 0.2]), RATE)
    plant = plant_of(random)
    return observer_law(plant, criterion, np.array([0.013, 0.047]))._replace(**fields)


def filtered_law_of(random: np.random.Generator) -> ObserverLaw:
    """With a filter of seven samples, three of them in two frames before the instant, three in a frame after it."""
    taps, offsets = random.normal(size=(2, 7)), np.r_[2.0, 1.3, 0.7, 0.0, -0.5, -1.0, -2.0] / RATE / 2.0
    return law_of(random)._replace(taps=taps, offsets_s=offsets)


def observer_of(law: ObserverLaw, limit: float = 1e6, rate: float = 1e9, frame_rate: int = RATE) -> AgeObserver:
    signals, devices = law.D.shape
    spec: Any = SimpleNamespace(
        signals=["y"] * signals,
        devices=["u"] * devices,
        limits=np.full(devices, limit),
        rates=np.full(devices, rate),
        frame_rate=frame_rate,
        parameters=to_parameters(law),
    )
    return AgeObserver(spec)


@pytest.mark.parametrize("seed", SEEDS)
def test_motion_is_that_of_the_matrix_exponential(seed: int) -> None:
    random = np.random.default_rng(seed)
    plant, late = plant_of(random), np.array([0.013, 0.047])
    modes = modal(plant.A)
    law = law_of(random)._replace(poles=modes.poles, B=modes.W @ plant.B, downlink_s=late)
    issued = np.sort(random.uniform(0.0, 1.0, 8))
    sent = Sent(issued, random.normal(size=(8, 2, 1)))
    x = random.normal(size=(6, 1))
    z, ends = modes.W @ x, np.sort(random.uniform(0.0, 1.2, 4))
    changes = np.sort(np.concatenate([issued + late[0], issued + late[1], ends]))
    at = 0.0
    for end in changes:
        u = in_force(law, (at + end) / 2.0, sent)
        block = np.block([[plant.A, plant.B @ u], [np.zeros((1, 7))]])
        x = (expm(block * (end - at)) @ np.vstack([x, [[1.0]]]))[:6]
        at = float(end)
        if at in ends:
            assert np.allclose((modes.V @ turned(law, 0.0, at, z, sent)).real, x, atol=1e-11 * np.abs(x).max())
    step = turned(law, 0.0, 0.4, z, sent)
    assert np.allclose(turned(law, 0.4, 0.9, step, sent), turned(law, 0.0, 0.9, z, sent), atol=1e-11)


def test_motion_of_a_pole_at_zero_is_an_integral() -> None:
    law = law_of(np.random.default_rng(0))
    law = law._replace(poles=np.zeros_like(law.poles), downlink_s=np.zeros(2))
    z = turned(law, 0.0, 3.0, np.zeros((len(law.poles), 1), complex), Sent(np.array([1.0]), np.ones((1, 2, 1))))
    assert np.allclose(z[:, 0], 2.0 * law.B.sum(axis=1))


def test_modes_of_a_defective_matrix_are_near_it() -> None:
    A = -np.eye(4) + np.diag([1.0, 1.0, 0.0], 1)
    modes = modal(A)
    motion = (modes.V @ (np.exp(modes.poles)[:, None] * modes.W)).real
    assert np.allclose(motion, expm(A), atol=1e-6)


def test_washout_is_a_state_of_the_plant() -> None:
    plant = plant_of(np.random.default_rng(1))
    of = washed(plant, np.array([0.0, 3.0]))
    s = 0.7j
    plain = plant.C @ np.linalg.solve(s * np.eye(6) - plant.A, plant.B) + plant.D
    whole = of.C @ np.linalg.solve(s * np.eye(7) - of.A, of.B) + of.D
    assert np.allclose(whole, np.array([[1.0], [3.0 * s / (1.0 + 3.0 * s)]]) * plain)


@pytest.mark.parametrize("make", [law_of, filtered_law_of])
@pytest.mark.parametrize("age_s", [0.02, 0.024, 3.0 / RATE - 0.013, 0.1, 0.3])
@pytest.mark.parametrize("seed", [0, 1])
def test_sampled_law_gives_the_steps_of_the_class(seed: int, age_s: float, make: Callable[..., ObserverLaw]) -> None:
    random = np.random.default_rng(seed)
    law = make(random)
    observer, largest = observer_of(law, 1e30, 1e30), 0.0
    A, B, C, D = sampled_law(law, age_s)
    x = np.zeros(len(A))
    for k in range(60):
        y = random.normal(size=2)
        u = observer.step(1.0 + k / RATE + age_s, y, np.full(2, age_s), np.ones(2, bool))
        expected, x = C @ x + D @ y, A @ x + B @ y
        largest = max(largest, float(np.abs(expected).max()))
        assert np.abs(u - expected).max() <= 1e-12 * largest


def seen_states(random: np.random.Generator) -> ObserverLaw:
    """A law that sees each state, so its estimate is exact after a frame."""
    law = law_of(random)
    turning = law.poles.imag > 0.0
    modes = len(law.poles)
    C = np.vstack([np.eye(modes), -1j * np.eye(modes)[turning]])
    M = np.hstack([np.eye(modes), 1j * np.eye(modes)[:, turning]])
    signals = len(C)
    return law._replace(
        C=C, C_s=C, taps=np.ones((signals, 1)), D=random.normal(size=(signals, 2)), M=M, S=np.eye(signals)
    )


@pytest.mark.parametrize("seed", SEEDS)
def test_prediction_is_exact_whatever_the_ages(seed: int) -> None:
    """Setpoints are those of who knows the state at the time at which they act."""
    random = np.random.default_rng(100 + seed)
    law = seen_states(random)
    observer = observer_of(law)
    z: NDArray[np.complex128] = np.where(law.poles.imag > 0.0, 1.0 + 1.0j, 1.0)[:, None]
    sent, at, arrival = Sent(np.zeros(0), np.zeros((0, 2, 1))), 0.0, 0.0
    for _ in range(80):
        measured = at + float(random.integers(1, 4)) / RATE  # frames are lost
        arrival = max(arrival, measured) + float(random.uniform(0.001, 0.05))
        z, at = turned(law, at, measured, z, sent), measured
        y = (law.C @ z).real + law.D @ in_force(law, measured, sent)
        u = observer.step(arrival, y[:, 0], np.full(len(y), arrival - measured), np.ones(len(y), bool))
        sent = sent.after(arrival, np.zeros((2, 1)))
        ahead, then = z, measured
        for d in (0, 1):  # the first acts earlier
            ahead = turned(law, then, arrival + law.downlink_s[d], ahead, sent)
            then = arrival + law.downlink_s[d]
            sent.effect[-1, d] = u[d]
            assert u[d] == pytest.approx(-float((law.K[d] @ ahead).real[0]), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_innovation_is_zero_for_samples_of_the_model(seed: int) -> None:
    """The samples of a filter before and after the instant, whatever setpoints change in between."""
    random = np.random.default_rng(seed)
    law = filtered_law_of(random)
    sent = Sent(np.sort(random.uniform(0.9, 1.05, 9)), random.normal(size=(9, 2, 1)))
    z = turned(law, 0.0, 0.9, random.normal(size=(len(law.poles), 1)).astype(np.complex128), sent)
    y = np.zeros((2, 1))
    for tap, offset in zip(law.taps.T, law.offsets_s, strict=True):
        sample = turned(law, 0.9, 1.0 + offset, z, sent)
        y += tap[:, None] * ((law.C_s @ sample).real + law.D @ in_force(law, 1.0 + offset, sent))
    gain = (law.taps[:, None] * np.exp(law.poles[:, None] * law.offsets_s)).sum(axis=2)
    law = law._replace(C=law.C_s * gain)
    now = turned(law, 0.9, 1.0, z, sent)
    assert np.abs(innovation(law, 1.0, now, sent, y)).max() < 1e-10 * np.abs(y).max()


def test_signals_count_at_their_own_times() -> None:
    """The estimate is the same whatever the order in which signals arrive."""
    random = np.random.default_rng(7)
    law = law_of(random)
    law = law._replace(K=0.0 * law.K)
    values = random.normal(size=(20, 2))
    late, whole = observer_of(law), observer_of(law)
    for k in range(20):
        whole.step(k / RATE + 0.1, values[k], np.full(2, 0.1), np.ones(2, bool))
        second = max(k - 3, 0)
        age_s = np.array([0.1, 0.1 + (k - second) / RATE])
        late.step(
            k / RATE + 0.1, np.array([values[k, 0], values[second, 1]]), age_s, np.array([True, k >= 3 or k == 0])
        )
    for k in (17, 18, 19):
        late.step(k / RATE + 0.15, values[k], np.array([0.15 + 0.01, 0.15]), np.array([False, True]))
    assert np.allclose(late.estimates[-1].z, whole.estimates[-1].z, rtol=1e-9, atol=1e-12)


def test_estimate_restarts_after_a_long_gap() -> None:
    law = law_of(np.random.default_rng(3))
    observer, again = observer_of(law), observer_of(law)
    first = [observer.step(t, np.ones(2), np.zeros(2), np.ones(2, bool)) for t in (0.0, 0.1, 30.0)]
    observer.reset()
    assert np.array_equal(first[0], observer.step(0.0, np.ones(2), np.zeros(2), np.ones(2, bool)))
    again.step(30.0, np.ones(2), np.zeros(2), np.ones(2, bool))
    assert np.array_equal(again.estimates[-1].z[:, 0], observer_after(law).estimates[-1].z[:, 0])


def observer_after(law: ObserverLaw) -> AgeObserver:
    observer = observer_of(law)
    for t in (0.0, 0.1, 30.0):
        observer.step(t, np.ones(2), np.zeros(2), np.ones(2, bool))
    return observer


def test_setpoints_are_within_limits_and_rates() -> None:
    random = np.random.default_rng(4)
    observer, before = observer_of(law_of(random), 0.1, 1.0), None
    for k in range(100):
        u = observer.step(k / RATE, 10.0 * random.normal(size=2), np.zeros(2), np.ones(2, bool))
        assert np.abs(u).max() <= 0.1
        assert before is None or np.abs(u - before).max() <= 1.0 / RATE + 1e-12
        before = u


@pytest.mark.parametrize("seed", SEEDS)
def test_innovations_of_signs_are_those_of_an_observer_with_them(seed: int) -> None:
    """Superposition: an observer whose B and D have the signs has the innovations that the quadratic form says."""
    random = np.random.default_rng(seed)
    law = law_of(random, margin=1e12)
    signs = random.integers(-1, 2, 2).astype(float)
    other = law._replace(B=law.B * signs, D=law.D * signs)
    plain, signed = observer_of(law), observer_of(other)
    for k in range(40):
        y, t = random.normal(size=2), k / RATE + 0.05
        plain.step(t, y, np.full(2, 0.05), np.ones(2, bool))
        signed.sent = plain.sent
        signed._insert(round(t - 0.05, 12), y, np.ones(2, bool))
        z = plain.estimates[-1].z @ np.append(1.0, signs)
        assert np.allclose(z, signed.estimates[-1].z.sum(axis=1), atol=1e-9 * max(1.0, np.abs(z).max()))


def two_modes() -> DesignModel:
    """0.5 and 0.8 Hz, poorly damped; each device moves both."""
    parts = [np.array([[-a, w], [-w, -a]]) for a, w in ((0.1, 3.1), (0.2, 5.0))]
    A = np.block([[parts[0], np.zeros((2, 2))], [np.zeros((2, 2)), parts[1]]])
    B = np.array([[2.0, 0.6], [0.0, 0.4], [0.8, -2.0], [0.6, 0.0]])
    C = np.array([[1.0, 0.0, 0.5, 0.0], [0.3, 0.0, -1.0, 0.0]])
    G = np.array([[0.0, 1.0], [3.0, 0.0], [0.0, -2.0], [4.0, 0.0]])
    return DesignModel(A, B, G, C, np.zeros((2, 2)), np.eye(4)[[0, 2]])


def closed_loop(signs: Callable[[int], Array], seed: int, frames: int) -> AgeObserver:
    """The observer with its own model as the plant, whose devices act with signs by frame; noise as it expects."""
    size, age_s, plant = 0.02, 0.08, two_modes()
    criterion = Criterion(np.ones(2), 0.3, np.full(2, 0.1), RATE)
    law = observer_law(plant, criterion, np.full(2, 0.02))._replace(margin=15.0)
    random, observer = np.random.default_rng(seed), observer_of(law, 0.3, 10.0)
    kick = -modal(plant.A).W @ np.linalg.solve(plant.A, plant.G)
    z, sent = np.zeros((len(law.poles), 1), complex), Sent(np.zeros(0), np.zeros((0, 2, 1)))
    for k in range(frames):
        t = k / RATE
        z = turned(law, t - 1.0 / RATE, t, z, sent) + size * kick @ random.normal(size=(2, 1))
        y = (law.C @ z).real + 0.1 * size * random.normal(size=(2, 1))
        u = observer.step(t + age_s, y[:, 0], np.full(2, age_s), np.ones(2, bool))
        sent = sent.after(t + age_s, (signs(k) * u)[:, None])
    return observer


@pytest.mark.parametrize("truth", [(1.0, 1.0), (-1.0, 1.0), (1.0, 0.0), (-1.0, -1.0)])
def test_signs_of_actuators_are_recognised_and_come_back(truth: tuple[float, float]) -> None:
    after = closed_loop(lambda _: np.array(truth), 1, 900)
    assert after.signs.tolist() == list(truth)
    back = closed_loop(lambda k: np.array(truth if k < 600 else (1.0, 1.0)), 2, 1500)
    assert back.signs.tolist() == [1.0, 1.0]


def test_evidence_of_one_frame_is_limited() -> None:
    first = with_innovations(without_evidence(1), np.array([[1.0, -2.0]]), np.eye(1), np.ones(1, bool), 1.0)
    far = with_innovations(first, np.array([[1e6, -1.0]]), np.eye(1), np.ones(1, bool), 1.0)
    assert far.E <= first.E + 9.1
    every, log_ratios = ratios(first)
    assert log_ratios[every[:, 0].tolist().index(1.0)] == 0.0
    assert decided(first, 1e3).signs.tolist() == [1.0]


def test_parameters_keep_the_law_and_refuse_others() -> None:
    law = law_of(np.random.default_rng(2), margin=12.0)
    parameters = to_parameters(law)
    again = from_parameters(parameters, 2, 2)
    assert str(again) == str(law)
    assert np.array_equal(law.M, again.M)
    for wrong in ({"gain": 1.0}, {"K.re": [1.0]}):
        with pytest.raises(InputError, match="allowed"):
            from_parameters({**parameters, **wrong}, 2, 2)
    with pytest.raises(InputError, match=r"parameters\.S: none given"):
        from_parameters({name: value for name, value in parameters.items() if name != "S"}, 2, 2)
    with pytest.raises(InputError, match="frame_rate: 50 given"):
        observer_of(law, frame_rate=50)


@pytest.mark.parametrize(
    ("link", "pmus", "most"),
    [("ideal", "ideal", 1e-6), ("delay_100ms", "ideal", 1e-6), ("delay_100ms", "p_class", 0.2)],
)
def test_law_with_a_constant_delay_is_the_lqg(link: str, pmus: str, most: float) -> None:
    """Setpoints in a run that reaches no limit; an LQG's Kalman filter knows a PMU's filter, ours its free motion."""
    step = {"time": 1.0, "kind": "load_step", "load": "load_1", "change": -0.0005}
    signals = ["frequency"] if pmus == "p_class" else ["speed"]
    measurement = {"filter": pmus}
    fields = {"duration": 6, "link": link, "scenario": [step], "measurement": measurement}
    texts = [f"link={link}", f"measurement={{filter: {pmus}}}", f"controllers.0={{name: LQG, signals: {signals}}}"]
    case = load_case("two_area_free", texts)
    plant, controller = plant_residues(case), case.controllers[0]
    assert plant is not None
    late = np.array([mean_delay(case.link.down, case.run.devices)])
    law = from_lqg(plant, case.designed_on, controller, late)
    rows = {"name": "LQG"}, {"name": "mine", "policy": POLICY, "parameters": to_parameters(law)}
    results = (fd.simulate("two_area_free", controllers=[{**row, "signals": signals}], **fields) for row in rows)
    lqg, ours = (result.issued["value"] for result in results)
    assert np.abs(lqg).max() > 1e-4
    assert np.abs(ours - lqg).max() < most * np.abs(lqg).max()


def test_sampled_law_closes_the_loop_as_the_lqg_does() -> None:
    case = load_case("two_area_free", ["controllers.0.name=LQG", "link=delay_100ms"])
    plant, controller = plant_residues(case), case.controllers[0]
    assert plant is not None
    law = from_lqg(plant, case.designed_on, controller, np.array([0.03]))
    loop = delayed_loop(case)
    ours = Discrete(*sampled_law(law, 0.07), loop.controllers[0].signals, loop.controllers[0].devices)
    values = [eigen(of, sampled(of, 0.1)).values for of in (loop, loop._replace(controllers=[ours]))]
    slow = [of[np.abs(of) < 15.0] for of in values]
    assert len(slow[0]) == len(slow[1])
    assert np.abs(np.sort_complex(slow[0]) - np.sort_complex(slow[1])).max() < 1e-6
