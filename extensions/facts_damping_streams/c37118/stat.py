"""Conversion of STAT (6.3, table 7) and of the message time quality (6.2, table 3) to a frame's status and back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Bool1, Float1, Float2, Int1


DATA_ERROR, TEST_MODE = 1 << 15, 1 << 14  # of a frame's status (PmuFrame.msg)
COMMON = 0x3E00  # bits 13 to 9, with equal meaning in both
NO_INFORMATION, ABSENT, DO_NOT_USE = 1, 2, 3  # bits 15 and 14 of STAT; ABSENT: test mode, or absent data tags
CHANGE = 1 << 10  # bit 10 of STAT: the configuration has changed, or will within a minute

ERRORS_S = np.array([1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2])  # PMU_TQ 1 to 6: below this error; 7: above; 0: unknown
UNLOCKED_S = np.array([10.0, 100.0, 1000.0])  # unlocked time 0 to 2: below this time; 3: above
MESSAGE_S = np.array([10.0**n for n in range(-9, 2)])  # MSG_TQ 1 to 11: within this error
FAULT = 15  # MSG_TQ: the time is unreliable


def word(bits: Int1, there: Bool1, error_s: Float1, unlocked_s: Float1) -> Int1:
    """STAT of PMUs, (PMUs,).

    `there`: whether a PMU has sent anything; `unlocked_s`: time since its clock lost UTC, 0: locked; `error_s`: largest
    clock error since then. For a locked clock the quality is 0: not estimated.
    """
    wrong, tested = (bits & DATA_ERROR) > 0, (bits & TEST_MODE) > 0
    top = np.where(~there, ABSENT, np.where(wrong, DO_NOT_USE, np.where(tested, ABSENT, 0)))
    quality = np.where(unlocked_s > 0.0, 1 + np.searchsorted(ERRORS_S, error_s, side="right"), 0)
    unlocked = np.searchsorted(UNLOCKED_S, unlocked_s, side="right")
    return np.asarray(top << 14 | bits & COMMON | quality << 6 | unlocked << 4, np.int64)


def status(words: Int1) -> Int1:
    """A frame's status bits from STAT, (PMUs,)."""
    top = words >> 14
    bits = np.where((top == NO_INFORMATION) | (top == DO_NOT_USE), DATA_ERROR, np.where(top == ABSENT, TEST_MODE, 0))
    return np.asarray(bits | words & COMMON, np.int64)


def absent(words: Int1, values: Float2) -> Bool1:
    """Whether a PMU is absent: tagged as absent and without values, (PMUs, channels)."""
    return np.asarray((words >> 14 == ABSENT) & np.isnan(values).all(axis=1))


def message_quality(error_s: Float1) -> int:
    """MSG_TQ of a frame, from the worst clock; `error_s`: of unlocked clocks, as in `word`."""
    if error_s.size == 0:
        return 0
    code = 1 + int(np.searchsorted(MESSAGE_S, error_s.max()))
    return code if code <= len(MESSAGE_S) else FAULT
