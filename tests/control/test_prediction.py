"""Prediction by the identifier: an oscillator whose future is computed here, lost frames, runaways, runs, bad input."""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.case.loading import load_case
from facts_damping.control.compensation import HELD_NS, compensate, compensators
from facts_damping.control.table import SETTINGS
from facts_damping.errors import InputError
from facts_damping.simulation import loop
from tests.control.bench import FRAMES, SCALE
from tests.control.test_identifier import LIMIT, Observer, asked

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record

TURN = 0.998 * cmath.exp(2j * math.pi * 0.6 / FRAMES)  # of the oscillator from frame to frame
CLOSE = 1e-6  # of the scale: the period between frames is cut to a nanosecond
ANSWER = 0.02  # of the signal to a setpoint, in scales and limits
OWN = ("controllers.0.name=ANFTSC", "controllers.0.scheme=indirect", "duration=4")
DELAYED = ("link.up=[{delay: 0.1}]", "link.down=[{delay: 0.1}]")


def observer(turn: complex = TURN, answer: float = ANSWER, lag: float = 0.0, **parameters: float) -> Observer:
    """An identifier with two past values of the signal, that predicts over `lag`, in frames."""
    row = asked("ANFTSI", answer, lag / FRAMES, **{"identifier_span": 1.0, **parameters})
    return Observer(row._replace(known=row.known._replace(z_pole=turn), predicts=True))


def swing(setpoints: list[float], delay: int = 0) -> list[float]:
    """y(k) = 2 Re z y(k-1) - |z|^2 y(k-2) + b u(k-1-d), from rest at 1."""
    y = [1.0, 2.0 * TURN.real - abs(TURN) ** 2]
    for k in range(2, len(setpoints)):
        u = setpoints[k - 1 - delay] if k > delay else 0.0
        y.append(2.0 * TURN.real * y[-1] - abs(TURN) ** 2 * y[-2] + ANSWER * u)
    return y


def follow(
    seen: Observer, lag: float, setpoints: list[float], missing: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Predicted and true change over the delay at each frame whose future is known; every `missing`-th frame is lost.

    In scales. The true one between two frames is on the line between them.
    """
    y = swing(setpoints, math.ceil(lag))
    predicted, true = [], []
    for k in range(len(y) - math.ceil(lag) - 2):
        if not missing or k % missing:
            seen.frame(k, y[k] * SCALE)
        seen.issue(k, setpoints[k] * LIMIT)
        predicted.append(seen.state.change[0, 0] / SCALE)
        true.append(np.interp(k + 1 + lag, np.arange(len(y)), y) - y[k + 1])
    return np.array(predicted), np.array(true)


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize(("horizon", "span"), [(1, 1), (1, 6), (4, 4), (7, 3)])
@pytest.mark.parametrize("lag", [0.0, 0.4, 1.0, 6.0, 13.0, 29.5])
def test_free_oscillation_is_predicted_exactly_whatever_the_horizon(horizon: int, span: int, lag: float) -> None:
    """By the model that it starts from. Horizons that do not divide the delay are no matter."""
    predicted, true = follow(
        observer(lag=lag, identifier_horizon=horizon, identifier_span=span, identifier_eta=0.0), lag, [0.0] * 120
    )
    assert np.isnan(predicted[: horizon + span - 1]).all()  # frames that it rests on have not come yet
    assert predicted[horizon + span - 1 :] == pytest.approx(true[horizon + span - 1 :], abs=CLOSE)
    assert rms(true) > 0.2 or lag < 6.0


@pytest.mark.parametrize("lag", [1, 6, 20])
def test_setpoints_under_way_are_known_but_for_the_newest(lag: int) -> None:
    """The error is what the setpoint of this frame does instead of the one before: one frame's answer to a change."""
    setpoints = np.random.default_rng(1).uniform(-1.0, 1.0, 200).tolist()
    predicted, true = follow(observer(lag=lag, identifier_eta=0.0), lag, setpoints)
    unknown = ANSWER * np.diff(setpoints, prepend=0.0)[: len(true)]
    assert predicted[2:] == pytest.approx((true - unknown)[2:], abs=CLOSE)
    assert rms(unknown[2:]) > 0.01


def test_after_learning_it_is_right_where_the_start_was_wrong() -> None:
    """Of 0.45 Hz at the start, with half of the answer; 0.25 s ahead. Excited by setpoints held for 0.2 s."""
    held = np.repeat(np.random.default_rng(2).uniform(-0.3, 0.3, 500), 12).tolist()
    wrong = cmath.exp(2j * math.pi * 0.45 / FRAMES)
    predicted, true = follow(observer(wrong, ANSWER / 2.0, 15.0, identifier_eta=1.0), 15.0, held)
    start, _ = follow(observer(wrong, ANSWER / 2.0, 15.0, identifier_eta=0.0), 15.0, held)
    late = slice(-2000, None)
    assert rms((predicted - true)[late]) < 0.05 * rms(true[late])  # that of the measured signal in its place
    assert rms((predicted - true)[late]) < 0.1 * rms((start - true)[late])


def test_lost_frames_are_on_the_line_between_their_neighbours() -> None:
    """Each fifth; 0.2 s ahead: to a tenth of what the signal changes."""
    predicted, true = follow(observer(lag=12.0, identifier_eta=0.0), 12.0, [0.0] * 300, missing=5)
    assert np.isfinite(predicted[3:]).all()
    there = np.arange(len(true)) % 5 != 0  # at a lost frame the prediction before it stands
    assert rms((predicted - true)[there][3:]) < 0.1 * rms(true[there][3:])
    lost = ~there
    lost[0] = False
    assert predicted[lost].tolist() == predicted[np.flatnonzero(lost) - 1].tolist()


def test_runaway_is_no_prediction() -> None:
    """Of a model that doubles in 2 frames: within 10 times the largest signal for a few frames, not for 20."""
    near, _ = follow(observer(turn=complex(1.4), lag=2.0, identifier_eta=0.0), 2.0, [0.0] * 30)
    far, _ = follow(observer(turn=complex(1.4), lag=20.0, identifier_eta=0.0), 20.0, [0.0] * 50)
    assert np.isfinite(near[2:]).any()
    assert np.isnan(far).all()


def test_identifier_without_firing_rules_predicts_nothing() -> None:
    seen = observer(lag=6.0, identifier_eta=0.0)
    for k in range(4):
        seen.frame(k, 30.0 * SCALE)
    assert np.isnan(seen.state.change[0, 0])


def test_identifier_that_does_not_predict_gives_no_predicted_change() -> None:
    plain = Observer(asked("ANFTSI", 0.2, 0.1, identifier_span=6.0))
    for k in range(5):
        plain.frame(k, 0.001 * k)
    assert np.isnan(plain.state.change[0, 0])
    assert plain.jacobian == pytest.approx(0.2, rel=0.2)


def acted_on(change: float, made_ns: int, newest_ns: int) -> float:
    constants, state = compensators(["prediction"], [0.0], 1)
    state.change[0, 0], state.change_ns[0] = change, made_ns
    compensate(constants, state, 0, np.zeros(1, SETTINGS)[0], np.array([0.3]), newest_ns, 0.2, 1.0 / FRAMES)
    return float(state.signal[0, 0])


def test_predicted_change_is_added_while_it_is_new() -> None:
    assert acted_on(0.25, 0, HELD_NS) == 0.55
    assert acted_on(0.25, 0, HELD_NS + 1) == 0.3
    assert acted_on(math.nan, 0, 1) == 0.3
    assert acted_on(math.inf, 0, 1) == 0.3


def run(*sets: str) -> Record:
    return loop.run(load_case("two_area_small", [*OWN, *sets]))


def test_without_delay_it_is_none_with_the_same_identifier() -> None:
    predicted = run("link=ideal", "controllers.0.compensation=prediction")
    plain = run("link=ideal", "controllers.0.parameters.identifier_span=6")
    for name in ("frames", "issued", "applied", "machines", "devices", "learning"):
        assert getattr(predicted, name).tobytes() == getattr(plain, name).tobytes(), name
    assert np.any(plain.issued["value"] != 0.0)
    assert set(predicted.estimates["change"][10:]) == {0.0}
    assert np.isnan(plain.estimates["change"]).all()
    delayed = run(*DELAYED, "controllers.0.parameters.identifier_span=6")
    assert delayed.issued.tobytes() != run(*DELAYED, "controllers.0.compensation=prediction").issued.tobytes()


def test_in_a_run_it_says_where_the_signal_goes() -> None:
    """0.2 s ahead, the speeds' difference of `small`, from 1 s on: the error is three quarters of the change at most.

    Better than the measured signal in its place, and that of a model with one past value, which hardly moves.
    """
    errors = {}
    for span in (6, 0):
        record = run(
            *DELAYED, "controllers.0.compensation=prediction", f"controllers.0.parameters.identifier_span={span}"
        )
        rows = record.estimates[record.estimates["measured_ns"] > 1_000_000_000]
        assert rows["ahead"] == pytest.approx(0.2)
        weights = load_case("two_area_small", [*OWN]).system.signals["speed"].weights
        y = record.frames[:, [record.pmus.index(s) for s in weights], 2] @ np.array(list(weights.values()))
        at = np.searchsorted(record.time_ns, rows["measured_ns"])
        known = at + 13 < len(y)
        true = y[at[known] + 13] - y[at[known] + 1]
        errors[span] = rms(np.nan_to_num(rows["change"][known]) - true) / rms(true)
    assert errors[6] < 0.75
    assert errors[6] < errors[0]


def test_invalid_prediction_is_refused_with_what_is_allowed() -> None:
    asks = "controllers.0.compensation=prediction"
    with pytest.raises(InputError, match=r"'prediction' given; allowed: none, lead, phasor for LLC, or an indirect"):
        load_case(None, [asks])
    direct = [asks, "controllers.0.name=ANFTSC", "controllers.0.scheme=direct"]
    with pytest.raises(InputError, match=r"allowed: none, lead, phasor for ANFTSC direct, or an indirect") as error:
        load_case(None, direct)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match=r"'ANFGuMoI' given; allowed: ANFTSI with .* or an identifier_span"):
        load_case(None, [asks, "controllers.0.name=HBsWC", "controllers.0.parameters.identifier=ANFGuMoI"])
    with pytest.raises(InputError, match=r"identifier_span: 2\.5 given; allowed: whole numbers, 0 to 60 frames"):
        load_case(None, [*OWN, "controllers.0.parameters.identifier_span=2.5"])
    with pytest.raises(InputError, match=r"'smith' given; allowed: none, lead, phasor, prediction: the plant's mode"):
        loop.build_loop(load_case(None, [*OWN, "controllers.0.compensation=smith"]))


def test_indirect_controller_that_predicts_has_an_identifier_that_looks_back() -> None:
    case = load_case(None, ["controllers.0.name=HBsWC", "controllers.0.compensation=prediction"])
    parameters = case.controllers[0].parameters
    assert (parameters["identifier"], parameters["identifier_span"]) == ("ANFTSI", 6.0)
    assert load_case(None, ["controllers.0.name=HBsWC"]).controllers[0].parameters["identifier_span"] == 0.0
    again = load_case(None, ["controllers.0.name=HBsWC", "controllers.0.compensation=prediction"])
    assert again.document() == case.document()
