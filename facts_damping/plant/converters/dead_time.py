"""The dead time of a device as a queue of accepted setpoints that do not act yet; compiled.

A setpoint acts exactly `dead_time` (whole ns) after its acceptance, independent of frames and integration steps. Each
is a row of UNDER_WAY, the oldest first. A half-full queue, as after a flood of messages, is thinned: a setpoint
replaces the one before if that is too close to its own predecessor. So no setpoint acts early, the last one acts on
time, and the queue never overflows.
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

    from facts_damping.compiling.structs import Float1, Int1

DENSEST = 10_000  # setpoints/s, largest density of a thinned queue
CLOSE = NANOSECONDS // DENSEST  # ns

# A queued setpoint: its time of action, and its limited value, p.u.
UNDER_WAY = np.dtype([("due_ns", "i8"), ("value", "f8")])


def line(dead_times: Sequence[float]) -> tuple[NDArray[Any], Int1]:
    """Empty queues for devices with these dead times (s): (devices, room) of UNDER_WAY, and the length of each."""
    longest = max(dead_times, default=0.0)
    room = 2 * (2 + math.ceil(longest * DENSEST)) if longest > 0.0 else 0
    return np.zeros((len(dead_times), room), UNDER_WAY), np.zeros(len(dead_times), np.int64)


@compiled
def send(under_way: NDArray[Any], waiting: Int1, d: int, due_ns: int, value: float) -> None:
    """Queue a setpoint of device d, due no earlier than those in the queue."""
    n, room = waiting[d], under_way.shape[1]
    if 2 * n >= room and (n == room or under_way[d, n - 1].due_ns - under_way[d, n - 2].due_ns < CLOSE):
        n -= 1
    under_way[d, n].due_ns, under_way[d, n].value = due_ns, value
    waiting[d] = n + 1


@compiled
def arrive(under_way: NDArray[Any], waiting: Int1, target: Float1, end: int, now: int) -> int:
    """Apply the setpoints due by `now`; return the time of the next one, or `end`."""
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
