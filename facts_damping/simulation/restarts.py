"""Restart controllers and identifiers during a run with their initial state, like killed nodes."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

from facts_damping.compiling.structs import Struct
from facts_damping.control.faults import DEAD
from facts_damping.signals import NEVER

if TYPE_CHECKING:
    from facts_damping.control.bank import Bank, BankState


def restore(state: Any, fresh: Any, place: int) -> None:
    """Copy item `place` of `fresh` to `state`; it indexes the first axis of all arrays."""
    for present, before in zip(state, fresh, strict=True):
        if isinstance(present, Struct):
            restore(present, before, place)
        else:
            present[place] = before[place]


class Restarts:
    """Restarts of controllers after `dead` faults."""

    def __init__(self, bank: Bank, state: BankState) -> None:
        """`state`: of the controllers at the start of a run."""
        self._state, self._at = state, dict[int, list[int]]()
        for c, rows in enumerate(bank.faults.rows):
            for row in rows:
                if row["kind"] == DEAD and row["end"] < NEVER:
                    self._at.setdefault(int(row["end"]), []).append(c)
        self._fresh = deepcopy(state) if self._at else None

    def begin(self, tick: int) -> None:
        """Restart the controllers whose fault ends at a tick."""
        for c in self._at.get(tick, ()):
            restore(self._state, self._fresh, c)

    def ticks(self, until: int) -> list[int]:
        """Ticks with a restart, after tick 0 and before `until`, in order."""
        return sorted(tick for tick in self._at if 0 < tick < until)
