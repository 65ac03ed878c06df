"""The word STAT (6.3, table 7) and the quality of a message's time (6.2, table 3), from a frame's status and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

DATA_ERROR, TEST_MODE = 1 << 15, 1 << 14  # of a frame's status (PmuFrame.msg)
COMMON = 0x3E00  # bits 13 to 9, which mean the same in both
NO_INFORMATION, ABSENT, DO_NOT_USE = 1, 2, 3  # bits 15 and 14 of STAT; ABSENT: test mode, or absent data tags
CHANGE = 1 << 10  # bit 10 of STAT: the configuration has changed, or will within a minute

ERRORS_S = np.array([1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2])  # PMU_TQ 1 to 6: less than that; 7: more; 0: not told
UNLOCKED_S = np.array([10.0, 100.0, 1000.0])  # unlocked time 0 to 2: less than that; 3: more
MESSAGE_S = np.array([10.0**n for n in range(-9, 2)])  # MSG_TQ 1 to 11: within that
FAULT = 15  # MSG_TQ: the time cannot be relied on


def word(
    status: NDArray[np.int64], there: NDArray[np.bool_], error_s: NDArray[np.float64], unlocked_s: NDArray[np.float64]
) -> NDArray[np.int64]:
    """STAT of PMUs, (PMUs,).

    `there`: which have said something at all; `unlocked_s`: for how long their clocks have not followed UTC, 0: they
    do; `error_s`: how far these may be off by now. Of a clock that follows UTC the quality is 0: none is estimated.
    """
    wrong, tested = (status & DATA_ERROR) > 0, (status & TEST_MODE) > 0
    top = np.where(~there, ABSENT, np.where(wrong, DO_NOT_USE, np.where(tested, ABSENT, 0)))
    quality = np.where(unlocked_s > 0.0, 1 + np.searchsorted(ERRORS_S, error_s, side="right"), 0)
    unlocked = np.searchsorted(UNLOCKED_S, unlocked_s, side="right")
    return np.asarray(top << 14 | status & COMMON | quality << 6 | unlocked << 4, np.int64)


def status(words: NDArray[np.int64]) -> NDArray[np.int64]:
    """A frame's status bits of STAT, (PMUs,)."""
    top = words >> 14
    found = np.where((top == NO_INFORMATION) | (top == DO_NOT_USE), DATA_ERROR, np.where(top == ABSENT, TEST_MODE, 0))
    return np.asarray(found | words & COMMON, np.int64)


def absent(words: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which PMUs have said nothing: tagged as such, and without a value, (PMUs, channels)."""
    return np.asarray((words >> 14 == ABSENT) & np.isnan(values).all(axis=1))


def message_quality(error_s: NDArray[np.float64]) -> int:
    """MSG_TQ of a frame: that of the worst clock; `error_s`: of those that do not follow UTC, as in `word`."""
    if error_s.size == 0:
        return 0
    code = 1 + int(np.searchsorted(MESSAGE_S, error_s.max()))
    return code if code <= len(MESSAGE_S) else FAULT
