"""The clock of all nodes: steady time, wall time and sleep. On a loopback simulated time replaces it.

No other module of the nodes reads a clock, so that a loopback alone decides what time it is.
"""

from __future__ import annotations

from time import CLOCK_MONOTONIC, monotonic, sleep, time_ns

# Steady time, s, and its number in POSIX; a pause, s; wall time, ns since 1970.
__all__ = ["CLOCK_MONOTONIC", "monotonic", "sleep", "time_ns"]
