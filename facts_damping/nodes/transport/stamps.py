"""Epoch of the run: the wall time at which it began, if messages carry wall time (`stamp: wall`); else 0.

There is one epoch per process, as each node is a process. The plant sets it; other nodes learn it from the first frame.
Inside the nodes all times are simulated, from 0; the epoch is added on writing and subtracted on reading a message.
"""

from __future__ import annotations

from contextvars import ContextVar

from facts_damping.nodes import clock

DAY_NS = 86_400_000_000_000  # the clocks of hosts must differ by less

_epoch_ns: ContextVar[int] = ContextVar("_epoch_ns", default=0)
_learns: ContextVar[bool] = ContextVar("_learns", default=False)


def epoch_ns() -> int:
    """Offset added to simulated time, ns since 1970; 0 without wall time."""
    return _epoch_ns.get()


def begin(at_ns: int = 0, *, learns: bool = False) -> None:
    """Set the epoch, ns since 1970 or 0; `learns`: a received message may set it later."""
    _epoch_ns.set(at_ns)
    _learns.set(learns)


def restore(at_ns: int) -> None:
    """Reset the epoch to an earlier value of `epoch_ns`."""
    _epoch_ns.set(at_ns)


def accept(stamp_ns: int, start_ns: int) -> bool:
    """Whether a stamp, less the epoch, fits a tick that starts at `start_ns`; the first stamp may set the epoch."""
    if stamp_ns == start_ns:
        return True
    if epoch_ns() or not _learns.get() or abs(stamp_ns - clock.time_ns()) > DAY_NS:
        return False
    _epoch_ns.set(stamp_ns - start_ns)
    return True
