"""The wall time of the run's beginning, where its messages are stamped by the wall clock (`stamp: wall`); else 0.

One for a process, as a node is one. The plant sets it; others take it from the first frame that they hear. Inside the
nodes all times are simulated, from 0; what is written into a message has it on top, what is read has it taken off.
"""

from __future__ import annotations

import time
from contextvars import ContextVar

DAY_NS = 86_400_000_000_000  # clocks of hosts may differ by less

_epoch_ns: ContextVar[int] = ContextVar("_epoch_ns", default=0)
_learns: ContextVar[bool] = ContextVar("_learns", default=False)


def epoch_ns() -> int:
    """What is added to simulated time, ns since 1970; 0: nothing."""
    return _epoch_ns.get()


def begin(at_ns: int = 0, *, learns: bool = False) -> None:
    """A run begins at a wall time, ns since 1970, or at 0; `learns`: messages of others may say when."""
    _epoch_ns.set(at_ns)
    _learns.set(learns)


def restore(at_ns: int) -> None:
    """Know no more than before: what `epoch_ns` was then."""
    _epoch_ns.set(at_ns)


def accept(stamp_ns: int, start_ns: int) -> bool:
    """Whether a stamp, less what is known, is that of a tick that starts at `start_ns`; the first one is learnt."""
    if stamp_ns == start_ns:
        return True
    if epoch_ns() or not _learns.get() or abs(stamp_ns - time.time_ns()) > DAY_NS:
        return False
    _epoch_ns.set(stamp_ns - start_ns)
    return True
