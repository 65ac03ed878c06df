"""Identifiers: what they start from, which setpoint they pair with a measurement, what they learn from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.control.identifier import identifiers, identify, store_setpoints, write_estimates
from facts_damping.control.identifier_model import Identified
from facts_damping.control.inputs import Wiring
from facts_damping.neurofuzzy.table import IDENTIFIERS
from facts_damping.signals import ESTIMATE, NANOSECONDS, SETPOINT, to_ns
from tests.control.bench import (
    FRAMES,
    LIMITS,
    MS,
    PMUS,
    SCALE,
    SIGNALS,
    Entry,
    controller,
    delivery,
    known,
    settings_of,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

FIRST, SECOND = range(2)  # devices
LIMIT = LIMITS["first"][0]
UNIT = SCALE / LIMIT  # a normalised Jacobian of one, p.u./p.u.

every_kind = pytest.mark.parametrize("kind", IDENTIFIERS)


def asked(
    kind: str, jacobian: float = 0.2, lag: float = 0.0, device: int = FIRST, /, **parameters: float | str
) -> Identified:
    """An identifier without guards, but for those given; `jacobian` is normalised."""
    row = settings_of(controller("ANFTSC", "indirect", "thesis", loop_delay=lag, **parameters))
    return Identified(0, row, kind, ["speed"], [device], [LIMIT], known(jacobian=jacobian * UNIT), None)


class Observer:
    """Identifiers that are given frames of one PMU, and setpoints."""

    def __init__(self, *rows: Identified, rate: int = FRAMES) -> None:
        self.made, self.state = identifiers(rows, Wiring(SIGNALS, PMUS, {}, rate))
        self.rate = rate

    def ns(self, k: int) -> int:
        return k * NANOSECONDS // self.rate

    def frame(self, k: int, y: float, late_ms: float = 0.0, n: int = 0) -> None:
        measured = self.ns(k) / MS
        identify(self.made, self.state, n, delivery(Entry("A", measured, measured + late_ms, y)), 1)

    def issue(self, k: int, u: float, device: int = FIRST, n: int = 0) -> None:
        """A setpoint that rests on frame k."""
        row = np.zeros(1, SETPOINT)
        row["measured_ns"], row["value"], row["device"] = self.ns(k), u, device
        store_setpoints(self.made, self.state, n, row, 1)

    @property
    def jacobian(self) -> float:
        """Normalised."""
        return float(self.state.jacobian[0, 0, 0]) / UNIT

    @property
    def theta(self) -> NDArray[np.float64]:
        return np.array(self.state.learner.theta[0])

    @property
    def paired(self) -> tuple[float, float]:
        """Signal and setpoint, p.u., that the newest measurement was paired with."""
        y, u = self.state.learner.x[0]
        return float(y) * SCALE, float(u) * LIMIT


def follow(observer: Observer, delay: int, setpoints: list[float], b: float = 0.2) -> float:
    """The mean Jacobian in the last quarter of y(k) = 0.9 y(k-1) + b u(k-1-delay), normalised; b is the true one."""
    y, jacobians = 0.0, []
    for k, u in enumerate(setpoints):
        y = 0.9 * y + (b * setpoints[k - 1 - delay] if k > delay else 0.0)
        observer.frame(k, y * SCALE)
        observer.issue(k, u * LIMIT)
        jacobians.append(observer.jacobian)
    return float(np.mean(jacobians[-len(setpoints) // 4 :]))


@pytest.mark.parametrize("jacobian", [-2.0, -0.1, -1e-3, 0.01, 0.1, 0.5])
@every_kind
def test_start_has_the_jacobian_that_is_given(kind: str, jacobian: float) -> None:
    """ANFTSI: weight tanh(2 h u / s^2) has the slope itself. ANFGuMoI: the slope of a wavelet that is shifted by q nu.

    There w (q cos 5q + 5 sin 5q) exp(-q^2/2) / nu is 26 q w / nu for small q only: 0.17 % less than the given at 0.1.
    """
    q = jacobian * 5 / (26 * np.exp((np.pi / 10) ** 2 / 2))
    fraction = (q * np.cos(5 * q) + 5 * np.sin(5 * q)) * np.exp(-(q**2) / 2) / (26 * q) if kind == "ANFGuMoI" else 1.0
    assert Observer(asked(kind, jacobian)).jacobian == pytest.approx(jacobian * fraction, rel=1e-9)
    assert fraction == pytest.approx(1, rel=2e-3) or abs(jacobian) > 0.1


@every_kind
@settings(max_examples=50, deadline=None)
@given(y=st.floats(-0.1, 0.1), u=st.floats(-0.5, 0.5))
def test_start_predicts_that_little_changes_but_for_the_setpoint(kind: str, y: float, u: float) -> None:
    observer = Observer(asked(kind, 0.1))
    observer.frame(0, y * SCALE)
    observer.issue(0, u * LIMIT)
    observer.frame(1, 0.002)
    assert observer.paired == pytest.approx((y * SCALE, u * LIMIT), abs=1e-15)
    predicted, error = observer.state.prediction[0, 0], observer.state.error[0, 0]
    assert predicted / SCALE == pytest.approx(y + 0.1 * u, abs=0.003)
    assert error == pytest.approx(predicted - 0.002, abs=1e-15)


@pytest.mark.parametrize(("kind", "tolerance"), [("ANFTSI", 0.03), ("ANFGuMoI", 0.25)])
@pytest.mark.parametrize(("delay", "wrong"), [(0, 3), (3, 0)])
def test_jacobian_converges_where_setpoints_are_paired_right(
    kind: str, tolerance: float, delay: int, wrong: int
) -> None:
    """From a quarter of the true one, with random setpoints; paired with others of them it stays near zero."""
    setpoints = np.random.default_rng(1).uniform(-1, 1, 2000).tolist()
    right, off = (follow(Observer(asked(kind, 0.05, lag / FRAMES)), delay, setpoints) for lag in (delay, wrong))
    assert right == pytest.approx(0.2, rel=tolerance)
    assert abs(off) < 0.04


@every_kind
@pytest.mark.parametrize("delay", [6, 12])
def test_half_a_period_off_the_sign_turns(kind: str, delay: int) -> None:
    """An oscillation of twice the delay: without it the setpoint looks like its own opposite."""
    k, noise = np.arange(2000), np.random.default_rng(1).uniform(-0.1, 0.1, 2000)
    setpoints = (0.9 * np.sin(np.pi * k / delay) + noise).tolist()
    assert follow(Observer(asked(kind, 0.2, delay / FRAMES)), delay, setpoints) > 0.14
    assert follow(Observer(asked(kind, 0.2, 0.0)), delay, setpoints) < -0.08


@pytest.mark.parametrize("lag", [0.0, 1 / 60, 2 / 60, 3 / 60, 0.1, 0.1004, 0.11])
def test_paired_setpoint_was_in_force_for_most_of_the_frame(lag: float) -> None:
    """From frame k-1 to k: with a lag of d frames that is u(k-1-d), and a little more lag does not make it another."""
    observer = Observer(asked("ANFTSI", 0.2, lag))
    for k in range(60):
        observer.frame(k, 0.0)
        if k > 10:
            assert observer.paired[1] == pytest.approx((k - 1 - round(lag * FRAMES)) * 1e-3, abs=1e-12)
        observer.issue(k, k * 1e-3)


@settings(max_examples=60, deadline=None)
@given(
    lag=st.floats(0, 1),
    rate=st.sampled_from([25, 30, 50, 60, 120]),
    seed=st.integers(0, 2**31),
    missing=st.sampled_from([0.0, 0.1]),
)
def test_setpoints_are_kept_for_as_long_as_they_are_needed(lag: float, rate: int, seed: int, missing: float) -> None:
    """The one in force half-way from the frame before to this one, as a search through all finds it."""
    observer, rng = Observer(asked("ANFTSI", 0.2, lag), rate=rate), np.random.default_rng(seed)
    issued: list[tuple[int, float]] = []
    before = checked = 0
    for k in range(round(1.5 * rate) + 10):
        if rng.uniform() < missing:
            continue
        observer.frame(k, 0.0)
        if k == before + 1:
            until = observer.ns(k) - (observer.ns(k) - observer.ns(before)) // 2 - to_ns(lag)  # to the whole ns
            expected = next((value for measured, value in reversed(issued) if measured <= until), 0.0)
            assert observer.paired[1] == pytest.approx(expected, abs=1e-15)
            checked += expected != 0
        issued.append((observer.ns(k), float(rng.uniform(-LIMIT, LIMIT))))
        observer.issue(k, issued[-1][1])
        before = k
    assert checked > 0


def test_setpoints_of_other_devices_are_not_its_own() -> None:
    observer = Observer(asked("ANFTSI"))
    observer.frame(0, 0.0)
    observer.issue(0, 0.2, FIRST)
    observer.issue(0, 0.1, SECOND)
    observer.frame(1, 0.0)
    assert observer.paired[1] == pytest.approx(0.2)


def test_only_frames_that_follow_one_another_teach() -> None:
    observer = Observer(asked("ANFTSI"))
    for k, y, learns in ((0, 0.001, False), (1, 0.003, True), (3, 0.004, False), (4, 0.006, True), (40, 0.0, False)):
        start = observer.theta
        observer.frame(k, y)
        assert (not np.array_equal(observer.theta, start)) == learns
        if k == 4:
            assert observer.paired[0] == pytest.approx(0.004)


def test_stale_frames_teach_nothing_but_are_what_the_next_is_paired_with() -> None:
    guarded, plain = Observer(asked("ANFTSI", stale=1.0)), Observer(asked("ANFTSI"))
    start = guarded.theta
    for k in range(10):
        for observer in (guarded, plain):
            observer.frame(k, 0.003 + 1e-4 * k, late_ms=1001.0)
    np.testing.assert_array_equal(guarded.theta, start)
    assert not np.array_equal(plain.theta, start)
    guarded.frame(10, 0.0, late_ms=999.0)
    assert guarded.paired[0] == pytest.approx(0.0039)
    assert not np.array_equal(guarded.theta, start)


@pytest.mark.parametrize("leakage", [0.0, 0.01])
def test_leakage_leads_back_to_the_start(leakage: float) -> None:
    """After a signal that taught, silence: with leakage the Jacobian is again that of the start."""
    observer = Observer(asked("ANFTSI", 0.2, identifier_leakage=leakage))
    follow(observer, 0, np.random.default_rng(1).uniform(-1, 1, 500).tolist(), b=0.6)
    assert observer.jacobian > 0.3
    for k in range(500, 1500):
        observer.frame(k, 0.0)
        observer.issue(k, 0.0)
    assert (observer.jacobian == pytest.approx(0.2, rel=0.01)) == (leakage > 0)


def test_identifiers_side_by_side_are_as_each_alone() -> None:
    """Of different networks, lags and devices."""
    rows = [asked("ANFTSI", 0.2, 0.05, SECOND), asked("ANFGuMoI", -0.1, 0.4, FIRST)]
    rng, both, alone = np.random.default_rng(3), Observer(*rows), [Observer(row) for row in rows]
    for k in range(60):
        y, u, v = rng.normal() * 0.003, rng.uniform(-0.3, 0.3), rng.uniform(-0.1, 0.1)
        for n, single in enumerate(alone):
            for observer, place in ((both, n), (single, 0)):
                observer.frame(k, y, n=place)
                observer.issue(k, u, FIRST, place)
                observer.issue(k, v, SECOND, place)
    for n, single in enumerate(alone):
        assert both.state.jacobian[n, 0, 0] == single.state.jacobian[0, 0, 0]
        assert both.state.prediction[n, 0] == single.state.prediction[0, 0]


def test_given_weights_are_the_start() -> None:
    trained = Observer(asked("ANFTSI"))
    for k in range(20):
        trained.frame(k, 0.004 * np.sin(k))
    again = Observer(asked("ANFTSI")._replace(weights=trained.theta))
    np.testing.assert_array_equal(again.theta, trained.theta)
    assert again.jacobian != Observer(asked("ANFTSI")).jacobian


def test_estimate_says_whose_it_is_and_from_what_it_was_made() -> None:
    observer, rows = Observer(asked("ANFTSI", 0.2, 0.0, SECOND)._replace(controller=5)), np.zeros(2, ESTIMATE)
    assert write_estimates(observer.made, observer.state, 0, 3, rows, 1) == 2
    assert not rows[0]["tick"]
    assert [rows[1][name] for name in ("tick", "controller", "signal", "device", "measured_ns")] == [
        3,
        5,
        0,
        SECOND,
        -1,
    ]
    assert rows[1]["jacobian"] == pytest.approx(0.2 * UNIT)
    assert np.isnan([rows[1]["prediction"], rows[1]["error"]]).all()
    for k in range(2):
        observer.frame(k, 0.002)
    write_estimates(observer.made, observer.state, 0, 4, rows, 1)
    assert rows[1]["measured_ns"] == observer.ns(1)
    assert rows[1]["error"] == rows[1]["prediction"] - 0.002
