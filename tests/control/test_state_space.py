"""The compiled observer with state feedback: against SciPy's simulation, and NumPy's with limits and lost frames."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import dlsim

from facts_damping.control.bank import Known, act, build_bank
from facts_damping.control.inputs import IMPLAUSIBLE, Wiring
from facts_damping.control.state_space import MAX_MISSED, StateSpace
from facts_damping.control.table import defaults, kind
from facts_damping.parameters.run import Controller
from facts_damping.signals import NANOSECONDS, SETPOINT
from tests.control.bench import FRAMES, LIMITS, MS, PMUS, SIGNALS, Entry, delivery, frame_ns, llc

if TYPE_CHECKING:
    from numpy.typing import NDArray

some = settings(deadline=None, max_examples=12)
WIDE = {"first": (1e9, 1e12), "second": (1e9, 1e12)}


def drawn(seed: int, states: int, signals: int, devices: int) -> StateSpace:
    """Matrices of a plant that oscillates a little unstably, with an estimator that is stable."""
    random = np.random.default_rng(seed)
    A = random.normal(size=(states, states))
    A *= 1.02 / np.abs(np.linalg.eigvals(A)).max()
    B, C = random.normal(size=(states, devices)), random.normal(size=(signals, states))
    P = np.eye(states)
    for _ in range(2000):  # the filter's Riccati equation, by recursion
        M = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(signals))
        P = A @ (P - M @ C @ P) @ A.T + np.eye(states)
    K = 0.1 * random.normal(size=(devices, states))
    return StateSpace(A, B, C, M, K)


class Given:
    """A controller with such matrices, beside a lead-lag, that is given frames of PMUs A and C."""

    def __init__(self, observer: StateSpace, limits: dict[str, tuple[float, float]]) -> None:
        self.signals, self.devices = len(observer.C), len(observer.K)
        row = Controller.model_validate(
            {
                "name": "LQG",
                "signals": ["speed", "power"][: self.signals],
                "devices": list(limits)[: self.devices],
                "parameters": defaults(kind("LQG"), "deployed"),
            }
        )
        plain = {"power": SIGNALS["power"].model_copy(update={"deviation": False})}
        rows = [llc("power", "second"), row]
        wiring = Wiring({**SIGNALS, **plain}, PMUS, limits, FRAMES)
        self.made, self.state = build_bank(rows, wiring, [Known(), Known(observer=observer)])

    def frame(self, k: int, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """The setpoints on frame k; empty where there are none."""
        at = frame_ns(k) / MS
        power = float(y[1]) if self.signals > 1 else 0.0
        delivered = delivery(Entry("A", at, at, float(y[0])), Entry("C", at, at, power=power))
        out = np.zeros(8, SETPOINT)
        end = act(self.made, self.state, 1, k, delivered, 2, out, 0)
        return np.array(out["value"][:end])


@pytest.mark.parametrize(
    ("states", "signals", "devices"), [(1, 1, 1), (4, 1, 1), (5, 2, 1), (3, 1, 2), (6, 2, 2), (1, 2, 2)]
)
def test_without_limits_it_is_a_linear_system(states: int, signals: int, devices: int) -> None:
    """By SciPy: with z(k) = x(k|k), z(k) = (1 - M C)(A - B K) z(k-1) + M y(k), u = -K z."""
    observer = drawn(states, states, signals, devices)
    bench, random = Given(observer, WIDE), np.random.default_rng(1)
    y = 1e-3 * random.normal(size=(60, signals))
    setpoints = np.array([bench.frame(k, row) for k, row in enumerate(y)])
    onward = (np.eye(states) - observer.M @ observer.C) @ (observer.A - observer.B @ observer.K)
    linear = (onward, onward @ observer.M, -observer.K, -observer.K @ observer.M, 1.0)  # its state is z without M y(k)
    _, expected, _ = dlsim(linear, y)
    assert np.abs(expected).max() > 1e-5
    np.testing.assert_allclose(setpoints, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


def followed(observer: StateSpace, y: dict[int, NDArray[np.float64]]) -> dict[int, NDArray[np.float64]]:
    """Setpoints by NumPy, frame by frame, with the limits of the bench."""
    limit, rate = np.array(list(LIMITS.values())).T[:, : len(observer.K)]
    x, u, reference, last = np.zeros(len(observer.A)), np.zeros(len(observer.K)), np.zeros(len(observer.K)), None
    setpoints = {}
    for k in range(max(y) + 1):
        if last is not None:
            reference = reference + np.clip(u - reference, -rate / FRAMES, rate / FRAMES)
            x = observer.A @ x + observer.B @ reference
        if k in y:
            x = x + observer.M @ (y[k] - observer.C @ x)
            setpoints[k] = u = np.clip(-observer.K @ x, -limit, limit)
            last = k
    return setpoints


@some
@given(seed=st.integers(0, 1000), lost=st.sets(st.integers(1, 59), max_size=40))
def test_with_limits_ramps_and_lost_frames_the_estimate_goes_on_by_itself(seed: int, lost: set[int]) -> None:
    observer = drawn(7, 4, 2, 2)
    bench, random = Given(observer, LIMITS), np.random.default_rng(seed)
    y = {k: random.normal(size=2) for k in range(60) if k not in lost}
    expected = followed(observer, y)
    for k, row in y.items():
        np.testing.assert_allclose(bench.frame(k, row), expected[k], rtol=1e-6, atol=1e-6)
    assert any(np.any(np.abs(u) == [limit for limit, _ in LIMITS.values()]) for u in expected.values())


def test_first_frame_starts_at_rest_and_counts_at_once() -> None:
    observer = drawn(3, 4, 2, 2)
    y = np.array([1e-3, 2e-3])
    np.testing.assert_allclose(Given(observer, WIDE).frame(5, y), -observer.K @ observer.M @ y, rtol=1e-9)
    assert Given(observer, WIDE).frame(5, 0.0 * y).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("value", [np.nan, np.inf, IMPLAUSIBLE])
def test_frame_that_is_not_available_is_a_lost_frame(value: float) -> None:
    observer = drawn(3, 4, 1, 1)
    bench, other = Given(observer, WIDE), Given(observer, WIDE)
    for k in (0, 1, 3):
        if k == 3:
            assert len(bench.frame(2, np.array([value]))) == 0
        setpoints = [row.frame(k, np.array([1e-3 * (k + 1)])) for row in (bench, other)]
        assert setpoints[0] == setpoints[1] != 0.0


def test_after_a_very_long_gap_it_begins_anew() -> None:
    observer = drawn(3, 4, 1, 1)
    bench, y = Given(observer, LIMITS), np.array([1e-3])
    first = bench.frame(0, y)
    bench.frame(1, 5 * y)
    assert bench.frame(2 + MAX_MISSED, y) == first
    assert bench.frame(100 * NANOSECONDS // FRAMES, y) == first  # a spoofed stamp, days ahead


@some
@given(data=st.data())
def test_setpoints_are_finite_and_within_limits_whatever_is_measured(data: st.DataObject) -> None:
    bench, now = Given(drawn(9, 5, 1, 2), LIMITS), 0
    rows: Any = st.tuples(st.integers(1, 700), st.floats(-0.99 * IMPLAUSIBLE, 0.99 * IMPLAUSIBLE))
    for gap, speed in data.draw(st.lists(rows, max_size=20)):
        now += gap
        setpoints = bench.frame(now, np.array([speed]))
        assert (np.abs(setpoints) <= [limit for limit, _ in LIMITS.values()]).all()
        assert np.isfinite(bench.state.estimate).all()
