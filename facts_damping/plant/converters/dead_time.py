"""The dead time of a device: setpoints that were accepted and do not act yet; compiled.

A delay line in whole nanoseconds: a setpoint acts exactly `dead_time` after it was accepted, whatever the frames and
the integrator's steps. What is under way is a row of UNDER_WAY each, the oldest first. A line that is half full, as by
a flood of messages, is thinned: a setpoint takes the place of the one before where that follows its own too closely.
So no setpoint acts early, the last one acts at its time, and the line is never full.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

DENSEST = 10_000  # setpoints/s that a line is thinned to
CLOSE = NANOSECONDS // DENSEST  # ns

# A setpoint under way: when it acts, and its value after the limits, p.u.
UNDER_WAY = np.dtype([("due_ns", "i8"), ("value", "f8")])


def line(dead_times: Sequence[float]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Empty delay lines of devices with such dead times (s): (devices, room) of UNDER_WAY, and how much is in each."""
    longest = max(dead_times, default=0.0)
    room = 2 * (2 + math.ceil(longest * DENSEST)) if longest > 0.0 else 0
    return np.zeros((len(dead_times), room), UNDER_WAY), np.zeros(len(dead_times), np.int64)


@compiled
def send(under_way: NDArray[Any], waiting: NDArray[np.int64], d: int, due_ns: int, value: float) -> None:
    """Put a setpoint of device d under way, due not before those that are."""
    n, room = waiting[d], under_way.shape[1]
    if 2 * n >= room and (n == room or under_way[d, n - 1].due_ns - under_way[d, n - 2].due_ns < CLOSE):
        n -= 1
    under_way[d, n].due_ns, under_way[d, n].value = due_ns, value
    waiting[d] = n + 1


@compiled
def arrive(under_way: NDArray[Any], waiting: NDArray[np.int64], target: NDArray[np.float64], end: int, now: int) -> int:
    """Put in force what is due by `now`; when the next one is, or `end`."""
    for d in range(waiting.size):
        due = 0
        while due < waiting[d] and under_way[d, due].due_ns <= now:
            target[d] = under_way[d, due].value
            due += 1
        if due > 0:
            waiting[d] -= due
            for i in range(waiting[d]):
                under_way[d, i] = under_way[d, due + i]
        if waiting[d] > 0:
            end = min(end, under_way[d, 0].due_ns)
    return end
