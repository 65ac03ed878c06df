"""Several signals and devices: a controller and its identifier against NumPy, starts, rates, Lyapunov functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.control.bank import Known, build_bank, pull
from facts_damping.control.identifier import identifiers, identify, store_setpoints
from facts_damping.control.identifier_model import Identified
from facts_damping.control.inputs import Wiring
from facts_damping.control.neuro_fuzzy import PlantPrior
from facts_damping.control.table import SETTINGS, defaults, kind
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.parameters.plant.pmus import Signal
from facts_damping.parameters.run import Controller
from facts_damping.signals import SETPOINT
from tests.control.bench import CHANGE_SCALE, FRAMES, LIMITS, MS, PMUS, SCALE, Bench, Entry, delivery, frame_ns, llc

SIGNALS = {
    name: Signal(channel="speed_deviation", weights={pmu: 1.0})
    for name, pmu in (("first", "A"), ("second", "B"), ("third", "C"))
}
THREE = {**LIMITS, "third": (0.2, 8.0)}
TURN = complex(np.exp(1j * 0.063))
RATIO = 4.0  # how far the second signal swings beside the first


def known(signals: int, devices: int, sign: Any = -1.0, jacobian: Any = 0.1) -> PlantPrior:
    swing = np.array([1.0, RATIO * 1j, 0.5])[:signals]
    many = np.ones((signals, devices))
    return PlantPrior(many * sign, many * jacobian, swing, TURN)


def mimo(
    name: str, scheme: str, signals: int = 2, devices: int = 2, profile: str = "thesis", /, **parameters: Any
) -> Controller:
    values = {**defaults(kind(name), profile, signals, devices), **parameters}
    given_signals, given_devices = list(SIGNALS)[:signals], list(THREE)[:devices]
    return Controller.model_validate(
        {"name": name, "scheme": scheme, "signals": given_signals, "devices": given_devices, "parameters": values}
    )


class Mimo(Bench):
    """A controller of several signals, one a PMU, and several devices."""

    def __init__(self, row: Controller, plant: PlantPrior | None = None) -> None:
        prior = plant or known(len(row.signals), len(row.devices))
        super().__init__(row, signals=SIGNALS, limits=THREE, plant=prior)

    def values(self, k: int, y: Any) -> list[float]:
        """The setpoints on frame k."""
        measured = frame_ns(k) / MS
        entries = [Entry(s, measured, measured, float(v)) for s, v in zip(PMUS, [*y, 0, 0], strict=False)]
        return [float(v) for v in self.give(*entries)["value"]]


class Reference:
    """MIMO ANFTSC in NumPy: (6.4), (6.5), (6.20), (6.24) to (6.26); two rules, inputs [e, de] of each signal."""

    def __init__(self, spread: float, width: float, weight: Any, eta: float, hbar: Any, scale: Any) -> None:
        m, k = 2 * len(scale), len(weight)
        swing = np.array([1.0, RATIO * 1j])
        change = np.array(scale) * CHANGE_SCALE / SCALE
        phasors = np.stack([swing / scale, swing * (1 - 1 / TURN) / change], axis=1).ravel()
        fraction = np.cos(np.angle(phasors) - np.angle(phasors[0] + phasors[1]))
        fraction[:2] = 1.0
        self.h = np.outer(fraction * spread, [-1, 1])
        self.s = np.full((m, 2), width)
        self.w = np.zeros((2, k, 1 + m))
        self.w[:, :, 0] = np.outer([-1, 1], -np.array(weight))
        self.eta, self.hbar, self.scale, self.change = eta, np.array(hbar), np.array(scale), change
        self.y: Any = None
        self.u: Any = None
        self.slopes: Any = None

    @property
    def theta(self) -> Any:
        return np.concatenate([np.stack([self.h, self.s], axis=2).ravel(), self.w.ravel()])

    def frame(self, y: Any, J: Any) -> Any:
        e = -np.array(y) / self.scale
        if self.slopes is not None:
            ec = e @ J - self.hbar * self.u
            by_h, by_s, by_w = self.slopes  # (outputs, inputs, rules), the same, (rules, inputs + 1)
            self.h, self.s = (
                self.h + self.eta * np.einsum("o,oij", ec, by_h),
                self.s + self.eta * np.einsum("o,oij", ec, by_s),
            )
            self.w = self.w + self.eta * ec[None, :, None] * by_w[:, None, :]
        change = np.zeros_like(e) if self.y is None else -(np.array(y) - self.y) / self.change
        x = np.clip(np.stack([e, change], axis=1).ravel(), -3, 3)
        F = np.exp(-(((x[:, None] - self.h) / self.s) ** 2)).prod(axis=0)
        G, z = F / F.sum(), self.w @ np.concatenate([[1.0], x])  # (rules, outputs)
        self.u, self.y = G @ z, np.array(y)
        apart = (G[:, None] * (z - self.u)).T[:, None, :]
        gap = x[:, None] - self.h
        by_w = G[:, None] * np.concatenate([[1.0], x])
        self.slopes = [apart * 2 * gap / self.s**2, apart * 2 * gap**2 / self.s**3, by_w]
        limits = [THREE[name][0] for name in list(THREE)[: len(self.u)]]
        return np.clip(limits * self.u, np.negative(limits), limits)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), eta=st.floats(0, 0.02), hbar=st.lists(st.floats(0, 0.5), min_size=2, max_size=2))
def test_history_is_that_of_the_equations(seed: int, eta: float, hbar: list[float]) -> None:
    """Two signals, two devices, any Jacobian; lists of penalties and weights."""
    rng, weight = np.random.default_rng(seed), [0.8, 0.3]
    row = mimo("ANFTSC", "indirect", spread=0.6, width=1.3, weight=weight, eta=eta, hbar=hbar)
    bench, reference = Mimo(row), Reference(0.6, 1.3, weight, eta, hbar, np.array([SCALE, RATIO * SCALE]))
    limits = np.array([THREE[name][0] for name in row.devices])
    for k in range(50):
        J, y = rng.normal(size=(2, 2)), rng.normal(size=2) * [0.004, 0.02]
        bench.state.jacobian[0] = J * reference.scale[:, None] / limits
        np.testing.assert_allclose(bench.values(k, y), reference.frame(y, J), atol=1e-10)
        np.testing.assert_allclose(bench.theta, reference.theta, rtol=1e-9, atol=1e-10)


def test_single_scale_is_the_first_signals_and_a_list_is_taken_as_it_is() -> None:
    bench, two = Mimo(mimo("ANFTSC", "direct", scale=0.02)), Mimo(mimo("ANFTSC", "direct", scale=[0.02, 0.05]))
    assert bench.bank.settings["scale"][0].tolist() == [0.02, 0.02 * RATIO]
    assert bench.bank.settings["change_scale"][0].tolist() == [CHANGE_SCALE, CHANGE_SCALE * RATIO]
    assert two.bank.settings["scale"][0].tolist() == [0.02, 0.05]
    bench.values(0, [0.01, 0.01])
    assert bench.state.learner.x[0].tolist() == pytest.approx([-0.5, 0, -0.01 / 0.02 / RATIO, 0])


@pytest.mark.parametrize("name", VARIANTS)
def test_mimo_controller_starts_with_sign_and_weight_of_each_device(name: str) -> None:
    """The first signal's sign to it; the direct scheme leaves out what has no sign."""
    sign = np.array([[-1.0, 1.0], [0.0, 1.0]])
    bench = Mimo(mimo(name, "direct", weight=[0.4, 0.2], eta=0.0), known(2, 2, sign))
    y = [0.003, 0.0]
    first, second = bench.values(0, y)
    assert first > 0 > second  # u = S net(-y)
    assert second / first == pytest.approx(-0.5 * LIMITS["second"][0] / LIMITS["first"][0], rel=0.2)
    bench.values(1, [0.003, 0.003])
    assert bench.state.memory.jacobian[0].tolist() == sign.tolist()


def test_input_pulls_as_far_as_it_swings_with_the_first_signals() -> None:
    """In phase 1, opposite -1, a quarter off 0."""
    rows = np.zeros(4, SETTINGS)
    rows["scale"], rows["change_scale"] = 0.01, 1e9  # changes count for nothing
    turned = np.exp(1j * np.deg2rad([0, 0, 180, 90]))
    pulls = pull(PlantPrior(np.ones((4, 1)), np.ones((4, 1)), turned, TURN), rows)
    assert pulls[:2].tolist() == [1, 1]
    assert pulls[[2, 4, 6]] == pytest.approx([1, -1, 0], abs=1e-6)


@pytest.mark.parametrize("scheme", ["direct", "indirect"])
@pytest.mark.parametrize("name", [*VARIANTS, "b-spline-interpolated+sam"])
def test_three_signals_and_three_devices(name: str, scheme: str) -> None:
    """Any history: setpoints within limits, and every device's learns."""
    bench, rng = Mimo(mimo(name, scheme, 3, 3, "deployed")), np.random.default_rng(1)
    limits, start = np.array([limit for limit, _ in THREE.values()]), bench.theta
    for k in range(60):
        bench.state.jacobian[0] = -0.1 * rng.random((3, 3))
        u = np.array(bench.values(k, rng.normal(size=3) * 0.004))
        assert u.shape == (3,)
        assert np.all(np.abs(u) <= limits)
    assert bench.state.memory.taught[0, 0] == 1
    net = bench.bank.shape[0]
    rules = (bench.theta - start)[net[2] * net[3] * net[5] :].reshape(2, 3, -1)
    assert np.all(np.abs(rules).max(axis=(0, 2)) > 0)


def test_lead_lag_of_two_devices_is_two_lead_lags() -> None:
    """Appendix B: gains 10 and 5; each with its own constants where a list says so."""
    row = Controller(signals=["difference"], devices=["first", "second"])
    values = {**defaults(kind("LLC"), "deployed", 1, 2), "T1": [0.2, 0.1]}
    both = Bench(row.model_copy(update={"parameters": values}))
    apart = [Bench(llc(gain=10.0, T1=0.2)), Bench(llc(device="second", gain=5.0, T1=0.1))]
    rng = np.random.default_rng(2)
    for k in range(50):
        entries = [Entry(s, 20 * k, 20 * k, float(rng.normal() * 1e-3)) for s in ("A", "B")]
        first, second = both.give(*entries)
        for setpoint, single in zip((first, second), apart, strict=True):
            (expected,) = single.give(*entries)
            assert (setpoint["value"], setpoint["device"]) == (expected["value"], expected["device"])


# Lyapunov functions


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**31), eta=st.floats(0.01, 2.0), name=st.sampled_from(list(VARIANTS)))
def test_step_below_the_bound_never_lets_the_lyapunov_function_grow(seed: int, eta: float, name: str) -> None:
    """(6.15) of random networks, errors and Jacobians, to first order in the parameters; the bound is eta = 2."""
    rng = np.random.default_rng(seed)
    hbar = (10 ** rng.uniform(-3, 1, 2)).tolist()
    bench = Mimo(mimo(name, "indirect", rate="lyapunov", eta=eta, hbar=hbar))
    learner, limits = bench.state.learner, np.array([THREE[n][0] for n in list(THREE)[:2]])
    for k in range(6):
        moved = learner.theta[0] + rng.normal(size=learner.theta.shape[1]) * 0.2
        learner.theta[0] = np.clip(moved, learner.low[0], learner.high[0])
        bench.state.jacobian[0] = rng.normal(size=(2, 2)) * np.array([[SCALE], [RATIO * SCALE]]) / limits
        bench.values(k, rng.normal(size=2) * [0.004, 0.02])
        value, fall = bench.state.memory.lyapunov[0]
        assert fall >= -1e-9 * value
        if bench.state.memory.taught[0, 0]:
            e = -bench.state.held.signal[0] / [SCALE, RATIO * SCALE]
            u = bench.state.memory.applied[0] / limits
            assert value == pytest.approx(0.5 * (e @ e + (hbar * u) @ u), rel=1e-9)


def test_beyond_the_bound_it_grows() -> None:
    """One device, one error: from eta = 2 on it is overshot by more than it was."""
    falls = []
    for eta in (0.5, 1.0, 1.9, 2.1, 3.0):
        bench = Mimo(mimo("ANFTSC", "indirect", 1, 1, rate="lyapunov", eta=eta, hbar=1e-6))
        bench.state.jacobian[0] = SCALE / LIMITS["first"][0]
        bench.values(0, [0.003])
        bench.values(1, [0.003])
        value, fall = bench.state.memory.lyapunov[0]
        falls.append(fall / value)
    np.testing.assert_allclose(falls, 1 - (1 - np.array([0.5, 1.0, 1.9, 2.1, 3.0])) ** 2, atol=0.01)


# Identifiers


class Observer:
    """A MIMO identifier on a plant y(k) = A y(k-1) + B u(k-1), normalised."""

    def __init__(self, jacobian: Any, horizon: int = 1, plant: PlantPrior | None = None, **parameters: Any) -> None:
        row = mimo("ANFTSC", "indirect", identifier_horizon=horizon, loop_delay=0.0, **parameters)
        self.made, _ = build_bank([row], Wiring(SIGNALS, PMUS, THREE, FRAMES), [Known(known(2, 2))])
        self.scale = self.made.settings["scale"][0]
        self.limits = np.array([THREE[name][0] for name in row.devices])
        J = np.array(jacobian) * self.scale[:, None] / self.limits
        prior = (plant or known(2, 2))._replace(jacobian=J)
        asked = Identified(0, self.made.settings[0], "ANFTSI", row.signals, [0, 1], self.limits.tolist(), prior, None)
        self.ids, self.state = identifiers([asked], Wiring(SIGNALS, PMUS, THREE, FRAMES))

    def frame(self, k: int, y: Any, u: Any) -> None:
        measured = frame_ns(k) / MS
        entries = [Entry(s, measured, measured, float(v)) for s, v in zip(("A", "B"), y * self.scale, strict=True)]
        identify(self.ids, self.state, 0, delivery(*entries), 2)
        rows = np.zeros(2, SETPOINT)
        rows["measured_ns"], rows["device"], rows["value"] = frame_ns(k), [0, 1], u * self.limits
        store_setpoints(self.ids, self.state, 0, rows, 2)

    @property
    def jacobian(self) -> Any:
        return self.state.jacobian[0] / self.scale[:, None] * self.limits


def test_start_is_the_linear_plant_in_its_mode() -> None:
    """A mode's swing is predicted to the last digit, whatever its phase; the Jacobian is the one given."""
    J = [[-0.05, 0.02], [0.4, -0.3]]
    for horizon in (1, 7):
        observer = Observer(J, horizon)
        np.testing.assert_allclose(observer.jacobian, J, rtol=1e-12)
        swing = np.array([1.0, RATIO * 1j]) / observer.scale * observer.scale[0]  # normalised: the second by its scale
        for k in range(horizon + 1):
            observer.frame(k, 0.1 * (swing * TURN**k).real, np.zeros(2))
        np.testing.assert_allclose(observer.state.error[0], 0, atol=1e-12)
        predicted = observer.state.prediction[0] / observer.scale
        np.testing.assert_allclose(predicted, 0.1 * (swing * TURN**horizon).real, atol=1e-9)


@pytest.mark.parametrize("horizon", [1, 4])
def test_jacobian_of_a_linear_plant_is_found(horizon: int) -> None:
    """All four derivatives, from wrong ones; ahead by more frames it is that of setpoints held so long."""
    A, B = np.array([[0.9, 0.05], [-0.1, 0.8]]), np.array([[0.05, -0.03], [0.1, 0.2]])
    held = sum((np.linalg.matrix_power(A, i) @ B for i in range(horizon)), np.zeros((2, 2)))
    observer = Observer(0.3 * held, horizon, identifier_eta=0.1)
    rng, y, jacobians = np.random.default_rng(3), np.zeros(2), []
    u = np.zeros(2)
    for k in range(6000):
        if k % horizon == 0:
            u = rng.uniform(-1, 1, 2)
        observer.frame(k, y, u)
        y = A @ y + B @ u
        jacobians.append(observer.jacobian)
    np.testing.assert_allclose(np.mean(jacobians[-2000:], axis=0), held, rtol=0.15, atol=0.03)


def test_setpoints_of_the_horizon_are_averaged() -> None:
    observer = Observer(np.zeros((2, 2)), 3)
    setpoints = np.arange(1, 9)[:, None] * [0.05, -0.1]
    for k, u in enumerate(setpoints):
        observer.frame(k, np.zeros(2), u)
    x = observer.state.learner.x[0]
    np.testing.assert_allclose(x[2:4], setpoints[4:7].mean(axis=0), rtol=1e-12)  # frame 7 answers 4, 5 and 6


def test_identifiers_error_falls_by_lyapunov_rates() -> None:
    observer, rng = (
        Observer(np.full((2, 2), 0.1), 1, identifier_rate="lyapunov", identifier_eta=1.9),
        np.random.default_rng(4),
    )
    for k in range(100):
        observer.frame(k, rng.normal(size=2) * 0.3, rng.uniform(-1, 1, 2))
        value, fall = observer.state.lyapunov[0]
        assert fall >= -1e-12
        if k:
            assert value == pytest.approx(0.5 * float((observer.state.deviation[0] ** 2).sum()))
    assert observer.state.lyapunov[0, 1] > 0
