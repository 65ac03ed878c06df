"""Forced or natural: of swings with known modes, sources and noise, and in the verdict of runs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import facts_damping as fd
from facts_damping.analysis.forced import FORCED, NATURAL, NONE, UNDECIDED, Origin, origin, words
from facts_damping.analysis.verdict import FORCED as FORCED_OSCILLATION

FREE: Any = {"controllers": [], "supervision": None, "arm_at": None}
RATE, MODES = 20, ((0.55, 0.03), (1.1, 0.1))  # samples/s; Hz, damping ratio


def swings(seconds: float, seed: int, source: float = 0.0, hertz: float = 0.55, start: float = 0.0) -> Origin:
    """Origin of two modes in noise with a source of an amplitude at the input, and a start of the first mode."""
    rng, n = np.random.default_rng(seed), int(seconds * RATE)
    t, x = np.arange(n) / RATE, np.zeros((n, 2))
    drive = source * np.exp(2j * np.pi * hertz * t) / RATE
    for i, (frequency, ratio) in enumerate(MODES):
        omega = 2 * np.pi * frequency
        step, state = np.exp(complex(-ratio, np.sqrt(1 - ratio**2)) * omega / RATE), start * (i == 0) + 0j
        noise = (rng.normal(size=n) + 1j * rng.normal(size=n)) * np.sqrt(ratio * omega / RATE)
        for k in range(n):
            state = step * state + noise[k] + drive[k]
            x[k] += [state.real, (-1) ** i * 0.7 * state.real]
    return origin(t, 1e-4 * (x + 0.01 * rng.normal(size=x.shape)))


@pytest.mark.parametrize(("source", "hertz"), [(3.0, 0.68), (3.0, 0.25), (300.0, 0.55)])
def test_source_beside_modes_or_far_above_their_noise_is_forced(source: float, hertz: float) -> None:
    for seed in range(3):
        cause = swings(60.0, seed, source, hertz)
        assert cause.kind == FORCED
        assert cause.frequency_hz == pytest.approx(hertz, abs=0.005)


def test_modes_are_never_forced() -> None:
    noise = [swings(120.0, seed).kind for seed in range(6)]
    assert FORCED not in noise
    assert noise.count(NATURAL) >= 4
    assert all(swings(60.0, seed, start=30.0).kind == NATURAL for seed in range(3))


def test_record_too_short_for_its_noise_is_undecided() -> None:
    assert swings(20.0, 1).kind == swings(20.0, 1, 2.0).kind == UNDECIDED
    assert swings(8.0, 1).kind == NONE


def test_growth_until_a_limit_contains_it_is_natural() -> None:
    t = np.arange(0, 60, 1 / RATE)
    grows, begins = 1e-3 / (1 + np.exp(-0.3 * (t - 15))), 1e-3 * (1 - np.exp(-0.1 * t))
    kinds = [origin(t, size * np.sin(2 * np.pi * 0.5 * t)).kind for size in (grows, begins)]
    assert kinds == [NATURAL, FORCED]


def test_words_have_frequency_and_size() -> None:
    forced = Origin(FORCED, 0.634, 20.0, "", 2e-4)
    assert words(forced, 60.0) == "0.63 Hz, 12 mHz; damping control does not remove it"
    assert words(forced, None) == "0.63 Hz, 0.0002 p.u.; damping control does not remove it"


def test_verdict_of_a_run_says_that_it_is_forced() -> None:
    source = {"time": 2.0, "kind": "forced_oscillation", "machine": "G2", "frequency": 0.63, "amplitude": 0.02}
    for noise in (None, {"std": 0.003, "time_constant": 1.0}):
        run = fd.simulate("two_area_deployment", scenario=[source], duration=40.0, load_noise=noise, **FREE)
        assert run.summary["verdict"] == FORCED_OSCILLATION
        assert run.summary["verdict_because"].startswith("0.63 Hz, ")
        assert run.summary["limit_cycle"] is None
