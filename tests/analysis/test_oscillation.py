"""Stability, amplitude and settling of signals of known shape."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facts_damping.analysis.modes.oscillation import envelope, is_stable, settling_time

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from facts_damping.record import Record

T = np.arange(1200) / 60


def wave(sigma: float, frequency: float = 0.5, start: float = 1.0) -> NDArray[np.float64]:
    after = np.maximum(T - start, 0)
    return np.where(start > T, 0, 1e-3 * np.exp(-sigma * after) * np.sin(2 * np.pi * frequency * after))


def test_standstill_is_settled() -> None:
    assert settling_time(T, np.full(1200, 0.3), 1.0) == 0.0


@given(frequency=st.floats(0.4, 2.5), phase=st.floats(0, 6.3), drift=st.floats(-0.1, 0.1))
def test_envelope_is_the_amplitude_without_line(frequency: float, phase: float, drift: float) -> None:
    x = 2e-3 * np.sin(2 * np.pi * frequency * T + phase) + 5 + drift * T
    assert envelope(T, x[:, np.newaxis], 5, 10) == pytest.approx([2e-3], rel=0.02)


@pytest.mark.parametrize("sigma", [0.3, 0.5, 1.0])
def test_settling_time_of_a_pure_decay(sigma: float) -> None:
    x = np.where(T < 1, 0, np.exp(-sigma * np.maximum(T - 1, 0)))
    final = x[T[-1] - 5 <= T].mean()
    expected = -np.log(0.05 * (1 - final) + final) / sigma
    assert settling_time(T, x, 1.0) == pytest.approx(expected, abs=1 / 60 + 1e-9)


def test_settling_time_of_a_wave_lies_at_its_envelope() -> None:
    settled_s = settling_time(T, wave(0.5), 1.0)
    assert settled_s is not None
    assert np.log(1 / 0.05) / 0.5 - 1.0 <= settled_s <= np.log(1 / 0.05) / 0.5 + 0.5


@pytest.mark.parametrize("sigma", [0.0, -0.1, 0.05])
def test_never_settles(sigma: float) -> None:
    assert settling_time(T, wave(sigma), 1.0) is None


def test_stable(swing_record: Callable[..., Record]) -> None:
    assert is_stable(swing_record()) is True
    lost = np.ones(1200, np.bool_)
    lost[-1] = False
    assert is_stable(swing_record(in_synchronism=lost)) is False
    short = swing_record(600, configuration={"duration": 20, "frame_rate": 60})
    assert is_stable(short) is None
