"""Modes from noise: of a system whose poles are known, of runs against their linear model, and beside pyOMA-2."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from facts_damping.analysis import summarise
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.ambient import covariances, fit_ambient
from facts_damping.analysis.modes.ringdown import COVERED, interval
from facts_damping.case.loading import load_case
from facts_damping.simulation import loop
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled
from facts_damping_views.analysis.details import details, lines
from tests.analysis.ambient_signals import MODES, RATE, SHAPES, ambient, same_noise

if TYPE_CHECKING:
    from facts_damping.analysis.modes.ringdown import Fit
    from facts_damping.case.model import Case

# Of `ambient(same_noise())` by pyOMA-2 1.4.3 (`functions.ssi`: build_hank(method="cov", br=15, nb=20), SSI_fast and
# SSI_poles of order 8, on signals of variance one): frequency of the damped wave (Hz), damping ratio, standard errors.
PYOMA = np.array([(0.59918, 0.03875, 0.0073, 0.0125), (1.15445, 0.09053, 0.0162, 0.0171)])


def fitted(x: np.ndarray) -> Fit:
    fit = fit_ambient(np.arange(len(x)) / RATE, x)
    assert fit is not None
    return fit


def figures(fit: Fit) -> np.ndarray:
    """Frequency, damping ratio and their errors, by frequency."""
    return np.array(
        sorted((m.frequency_hz, m.damping_ratio, m.frequency_error_hz, m.damping_ratio_error) for m in fit.modes)
    )


def test_ambient_modes_agree_with_pyoma() -> None:
    measured = figures(fitted(ambient(same_noise())))
    assert len(measured) == 2
    assert (np.abs(measured[:, :2] - PYOMA[:, :2]) < 0.25 * PYOMA[:, 2:]).all()  # they take lag 1, too
    ratio = measured[:, 2:] / PYOMA[:, 2:]
    assert ((ratio > 0.6) & (ratio < 1.7)).all()


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """60 records of 5 minutes: of 240 intervals of 95 %, 228 +- 3.4 would; and they are no wider than needed."""
    random, held, off, sure = np.random.default_rng(1), [], [], []
    for _ in range(60):
        intervals = figures(fitted(ambient(random.standard_normal((3000, 6)))))
        nearest = intervals[[int(np.argmin(np.abs(intervals[:, 0] - frequency))) for frequency, _ in MODES]]
        held.append(np.abs(nearest[:, :2] - MODES) <= COVERED * nearest[:, 2:])
        off.append(nearest[:, :2] - MODES)
        sure.append(nearest[:, 2:])
    assert 0.88 < np.mean(held) < 0.99
    assert np.median(sure, axis=0) == pytest.approx(np.std(off, axis=0), rel=0.35)
    # Of one mode without noise nobody does better than sqrt(zeta / (2 pi f T)); the second is a fifth of the variance.
    bound = np.sqrt(MODES[:, 1] / (2 * np.pi * MODES[:, 0] * 300))
    assert (np.std(off, axis=0)[:, 1] < [1.5, 3.0] * bound).all()


def test_amplitudes_and_phases_are_those_of_the_shapes() -> None:
    x = ambient(np.random.default_rng(2).standard_normal((20_000, 6)))
    modes = sorted(fitted(x).modes)
    for mode, shape, pole in zip(modes, SHAPES.T, MODES, strict=True):
        assert mode.frequency_hz == pytest.approx(pole[0], rel=0.02)
        decay = np.exp(-2 * 2 * np.pi * pole[0] * pole[1] / np.sqrt(1 - pole[1] ** 2) / RATE)
        amplitude = np.abs(shape) * np.sqrt(2 / (1 - decay))  # Re x has the variance 1 / (1 - |z|^2)
        assert mode.amplitude == pytest.approx(amplitude, rel=0.15)
        difference = mode.phase_rad[1] - mode.phase_rad[0]
        assert np.cos(difference) == pytest.approx(np.sign(shape[0] * shape[1]), abs=0.1)


def test_noise_of_measurement_does_not_matter() -> None:
    """As much of it as of the signal, in the covariance at lag 0 alone."""
    random = np.random.default_rng(3)
    x = ambient(random.standard_normal((6000, 6)))
    clean, other = figures(fitted(x)), figures(fitted(x + x.std(axis=0) * random.standard_normal(x.shape)))
    assert (np.abs(clean[0, :2] - other[0, :2]) < 1.5 * other[0, 2:]).all()


def test_unit_and_a_signal_at_rest_do_not_matter() -> None:
    x = ambient(same_noise())
    still = np.zeros((len(x), 1))
    assert figures(fitted(1e-6 * x)) == pytest.approx(figures(fitted(x)), rel=1e-6)
    assert figures(fitted(np.hstack([x, still])))[:, :2] == pytest.approx(figures(fitted(x))[:, :2], rel=1e-3)


def test_covariances_are_those_of_the_definition() -> None:
    x = np.random.default_rng(4).standard_normal((400, 2))
    R = covariances(x).mean(axis=0)
    used = 360  # in whole blocks of all lags
    for place, lag in ((0, 2), (7, 9), (29, 31)):
        assert R[place] == pytest.approx(sum(np.outer(x[k + lag], x[k]) for k in range(used)) / used)


@pytest.mark.parametrize(
    "x", [np.zeros((6000, 1)), np.full((6000, 1), np.nan), ambient(np.random.default_rng(0).standard_normal((550, 6)))]
)
def test_constant_missing_or_short_signal_has_no_ambient_modes(x: np.ndarray) -> None:
    assert fit_ambient(np.arange(len(x)) / RATE, x) is None


def interarea(case: Case) -> complex:
    """Eigenvalue of the interarea mode of a linear closed loop without delay, 1/s."""
    linear = delayed_loop(case)
    values = eigen(linear, sampled(linear, 0.0)).values
    return next(complex(s) for s in values if 2.0 < s.imag < 6.0)


AMBIENT = load_case("two_area_ambient", ["duration=300"])


def test_run_tells_the_modes_of_the_linear_loop() -> None:
    """Five minutes of two areas with a controller; the open loop's mode grows."""
    record = loop.run(AMBIENT)
    summary: Any = summarise(record)
    assert (summary.modes_method, summary.stable) == ("ssi", True)
    s, mode = interarea(AMBIENT), summary.modes[0]
    assert mode.frequency_hz == pytest.approx(s.imag / (2 * np.pi), rel=0.03)
    for value, of in ((s.imag / (2 * np.pi), "frequency"), (-s.real / abs(s), "damping_ratio")):
        name, error = ("frequency_hz", "frequency_error_hz") if of == "frequency" else (of, f"{of}_error")
        low, high = interval(getattr(mode, name), getattr(mode, error))
        assert low <= value <= high
    assert 0.0 < mode.damping_ratio_error < 0.015
    text = "\n".join(lines(["run"], [summary], [details(record)], 0))
    assert "8 poles" in text
    assert f"frequency {mode.frequency_hz:.4f} Hz ± " in text
    asked: Any = summarise(record, method="matrix_pencil")
    assert asked.modes_method in ("matrix_pencil", None)


def test_run_with_an_event_is_a_ringdown_unless_asked_for() -> None:
    record = loop.run(load_case(None, ["load_noise.std=0.001", "duration=70"]))
    assert summarise(record).modes_method == "matrix_pencil"
    asked: Any = summarise(record, method="ssi")
    assert asked.modes_method == "ssi"
    assert asked.ringdown.start_s == 1.0
    signals = columns(speed_differences(record))
    assert asked.ringdown.snr_db == fit_ambient(record.time_s, signals, 1.0).snr_db  # type: ignore[union-attr]
