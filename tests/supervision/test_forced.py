"""The monitor `forced` on signals whose origin is known: a wave, modes in noise, ringdowns, limit cycles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.monitor_table import MONITORS
from facts_damping.supervision.model import SETTINGS
from facts_damping.supervision.monitors import constancy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

RATE, HERTZ, MINUTES = 30, 0.5, 10
LIMIT = MONITORS["forced"].limit
TIME = np.arange(60 * MINUTES * RATE) / RATE
DAMPING = (0.01, 0.02, 0.03, 0.05, 0.1, 0.15)


def watched(signal: Floats, damping: float, output: Floats | float = 0.1) -> Floats:
    """Values of the monitor; `damping`: ratio of the mode that the supervisor knows."""
    settings = np.zeros(1, SETTINGS)[0]
    settings["cycle"], settings["frame_rate"], settings["sigma"] = RATE / HERTZ, RATE, -damping * 2 * np.pi * HERTZ
    efforts, wave = np.broadcast_to(output, signal.shape), np.zeros(4)
    return np.array([constancy(wave, x, u, settings) for x, u in zip(signal, efforts, strict=True)])


def in_noise(damping: float, seed: int) -> Floats:
    """A mode that white noise drives, of variance 1."""
    pole = np.exp(2 * np.pi * HERTZ * complex(-damping, 1) / RATE)
    rng = np.random.default_rng(seed)
    kicks = np.sqrt(1 - abs(pole) ** 2) * (rng.normal(size=(2, len(TIME))).T @ (1, 1j))
    states = np.empty(len(TIME), complex)
    state = complex(*rng.normal(size=2))
    for k, kick in enumerate(kicks):
        state = pole * state + kick
        states[k] = state
    return states.real


@pytest.mark.parametrize("hertz", [0.2, 0.4, 0.5, 0.9])
def test_wave_that_begins_in_noise_is_forced_and_stays_so(hertz: float) -> None:
    begins = TIME >= 60.0
    values = watched(in_noise(0.1, 1) + 8.0 * begins * np.sin(2 * np.pi * hertz * TIME), 0.1)
    forced = values > LIMIT
    assert not forced[TIME < 90.0].any()
    assert forced[TIME > 105.0].all()


@pytest.mark.parametrize("damping", DAMPING)
def test_mode_in_noise_is_not_forced(damping: float) -> None:
    values = np.array([watched(in_noise(damping, seed), damping) for seed in range(5)])
    assert np.nanmax(values) < LIMIT
    assert np.isfinite(values).mean() > 0.5


@pytest.mark.parametrize("known", [0.01, 0.15])
@pytest.mark.parametrize("damping", DAMPING)
def test_ringdown_is_not_forced_however_well_its_damping_is_known(damping: float, known: float) -> None:
    swing = np.exp(-damping * 2 * np.pi * HERTZ * TIME) * np.cos(2 * np.pi * HERTZ * TIME)
    values = watched(swing, known, np.abs(swing))
    assert not (values > LIMIT).any()
    assert np.isfinite(values).any()


def test_limit_cycle_and_what_the_controller_does_not_answer_are_not_forced() -> None:
    swing = np.sin(2 * np.pi * HERTZ * TIME)
    assert np.nanmax(watched(swing, 0.1, 0.9 * np.abs(swing))) > LIMIT
    assert np.isnan(watched(swing, 0.1, np.minimum(1.0, 1.2 * np.abs(swing)))).all()
    assert np.nanmax(watched(swing, 0.1, 0.001 * np.abs(swing))) == 0.0
