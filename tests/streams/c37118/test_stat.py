"""STAT and the quality of time, by the codes of tables 3 and 7 of IEEE C37.118.2-2011."""

from __future__ import annotations

import numpy as np
import pytest

from facts_damping_streams.c37118 import stat


def word(status: int = 0, error_s: float = 0.0, unlocked_s: float = 0.0, *, there: bool = True) -> int:
    arguments = (np.array([status]), np.array([there]), np.array([error_s]), np.array([unlocked_s]))
    return int(stat.word(*arguments)[0])


@pytest.mark.parametrize(
    ("error_s", "code"),
    [(0.0, 1), (9e-8, 1), (1e-7, 2), (5e-6, 3), (5e-5, 4), (5e-4, 5), (5e-3, 6), (1e-2, 7), (3.0, 7)],
)
def test_pmus_time_quality(error_s: float, code: int) -> None:
    """Bits 8 to 6: below 100 ns 001, below 1 us 010 and so on; above 10 ms 111; of a clock in time 000."""
    assert word(error_s=error_s, unlocked_s=1.0) >> 6 & 7 == code
    assert word(error_s=error_s) >> 6 & 7 == 0


@pytest.mark.parametrize(("unlocked_s", "code"), [(0.0, 0), (9.9, 0), (10.0, 1), (99.0, 1), (500.0, 2), (1000.0, 3)])
def test_unlocked_time(unlocked_s: float, code: int) -> None:
    """Bits 5 and 4."""
    assert word(unlocked_s=unlocked_s) >> 4 & 3 == code


@pytest.mark.parametrize(
    ("errors_s", "code"),
    [([], 0), ([0.0], 1), ([1e-9], 1), ([2e-9], 2), ([1e-6], 4), ([1e-8, 3e-3], 8), ([10.0], 11), ([11.0], 15)],
)
def test_messages_time_quality(errors_s: list[float], code: int) -> None:
    """Locked 0, within 1 ns 1, 10 ns 2, and so on, 10 s 11; beyond, the clock has failed: 15."""
    assert stat.message_quality(np.array(errors_s)) == code


@pytest.mark.parametrize(
    ("status", "there", "top", "back"),
    [
        (0, True, 0b00, 0),
        (stat.DATA_ERROR, True, 0b11, stat.DATA_ERROR),
        (stat.TEST_MODE, True, 0b10, stat.TEST_MODE),
        (0, False, 0b10, stat.TEST_MODE),
        (0x2000 | stat.DATA_ERROR, True, 0b11, 0x2000 | stat.DATA_ERROR),
    ],
)
def test_data_errors(status: int, there: bool, top: int, back: int) -> None:
    bits = word(status, there=there)
    assert bits >> 14 == top
    assert int(stat.status(np.array([bits]))[0]) == back


def test_pmu_error_without_information_on_the_data_is_a_data_error() -> None:
    assert int(stat.status(np.array([0x4000]))[0]) == stat.DATA_ERROR


def test_pmu_is_absent_with_the_tag_and_without_a_value() -> None:
    words = np.array([word(there=False), word(stat.DATA_ERROR), word(there=False), word()])
    values = np.array([[np.nan], [np.nan], [1.0], [np.nan]])
    assert stat.absent(words, values).tolist() == [True, False, False, False]
