"""Recorded changes of controllers, identifiers and supervisors, applied in a replay at their ticks."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.controllers import check_parameter, sizes, with_weights
from facts_damping.control.table import kind_name, kind_of
from facts_damping.errors import InputError
from facts_damping.monitor_table import COMMANDS
from facts_damping.parameters.run import Weights
from facts_damping.record import Absence
from facts_damping.simulation.assembly import build_control
from facts_damping.simulation.changes import ask, set_parameter
from facts_damping.simulation.restarts import restore

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record, RunChange
    from facts_damping.simulation.tick import ControlSystem


# Nodes that a replay runs, by the tables that they write.
NODES = {
    **dict.fromkeys(("issued", "learning"), "controller"),
    **dict.fromkeys(("supervised", "supervision"), "supervisor"),
    "estimates": "identifier",
}


class ReplayedChanges:
    """Recorded changes, absences and silent times of controllers, identifiers and supervisors.

    Applies only to controllers of the same kind as recorded.
    """

    def __init__(self, case: Case, record: Record, control: ControlSystem) -> None:
        """`control`: controllers, identifiers and supervisors at the start."""
        before = [kind_name(row.get("name", "")) for row in record.configuration.get("controllers") or []]
        same = {c for c, row in enumerate(case.controllers) if kind_name(row.name) in before[c : c + 1]}
        applicable = [change for change in record.changes if change.index in same and _possible(case, change)]
        self._case, self._control = case, control
        self._changes = list(applicable)  # by tick; a recording that starts late includes earlier changes
        self._starts = {(change.role, change.index, change.tick) for change in applicable if change.kind == "start"}
        self._fresh = deepcopy(control) if self._starts else control
        self._absences = [gap for gap in record.absences if gap.role != "link" and gap.index in same]
        self._silent = [*self._absences, *_disarmed(applicable)]

    def begin(self, tick: int) -> None:
        """Apply the changes that act from a tick on."""
        while self._changes and self._changes[0].tick <= tick:
            change = self._changes.pop(0)
            if change.kind == "start":
                self._start_again(change.role, change.index)
            elif change.role == "supervisor":
                ask(self._control.supervisors, self._control.supervisor_state, change)
            elif change.kind == "weights":
                self._restore_weights(change.role, change.index, change.value)
            elif change.kind == "parameter":
                set_parameter(self._case, self._control.bank, self._control.identifiers, change)

    def _restore_weights(self, role: str, c: int, weights: dict[str, Any]) -> None:
        controllers, now = list(self._case.controllers), self._control
        controllers[c] = with_weights(controllers[c], Weights.model_validate(weights))
        _, bank_state, _, identifier_state = build_control(replace(self._case, controllers=controllers))
        if role == "controller":
            restore(now.bank_state.learner, bank_state.learner, c)
        else:
            place = list(now.identifiers.controller).index(c)
            restore(now.identifier_state.learner, identifier_state.learner, place)

    def absent(self, table: str, index: int, tick: int) -> bool:
        """Whether the node of a table (NODES) was absent from it at a tick."""
        return self._in(self._absences, table, index, tick)

    def idle(self, table: str, index: int, tick: int) -> bool:
        """Whether the node of a table did not work at a tick: absent from it, and not started again, disarmed."""
        starts = [at for role, place, at in self._starts if (role, place) == (NODES[table], index)]
        away = [gap for gap in self._absences if gap.table == table and gap.index == index and _within(gap, tick)]
        return any(not any(gap.first <= at <= tick for at in starts) for gap in away)

    def silent(self, table: str, index: int, tick: int) -> bool:
        """Whether the node of a table published nothing for it at a tick: it was absent or disarmed."""
        return self._in(self._silent, table, index, tick)

    def _in(self, absences: Sequence[Absence], table: str, index: int, tick: int) -> bool:
        return any(gap.index == index and _concerns(gap, table) and _within(gap, tick) for gap in absences)

    def published(self, table: str, rows: NDArray[Any]) -> NDArray[Any]:
        """Rows of a table, without those of silent ticks."""
        keep = np.ones(len(rows), np.bool_)
        for gap in self._silent:
            if _concerns(gap, table):
                keep &= ~(_within(gap, rows["tick"]) & (rows["controller"] == gap.index))
        return np.asarray(rows[keep])

    def _start_again(self, role: str, c: int) -> None:
        now, fresh = self._control, self._fresh
        if role == "controller":
            restore(now.bank_state, fresh.bank_state, c)
            now.bank.settings[c] = fresh.bank.settings[c]
        elif role == "supervisor":
            for place in np.flatnonzero(now.supervisors.settings["controller"] == c).tolist():
                restore(now.supervisor_state, fresh.supervisor_state, place)
        else:
            place = list(now.identifiers.controller).index(c)
            restore(now.identifier_state, fresh.identifier_state, place)
            now.identifiers.settings[place] = fresh.identifiers.settings[place]


def _concerns(absence: Absence, table: str) -> bool:
    return absence.role == NODES[table] and absence.table in ("", table)


def _within(absence: Absence, tick: Any) -> Any:
    return (tick >= absence.first) & (tick < absence.end)


def _possible(case: Case, change: RunChange) -> bool:
    """Whether a change is valid for the case's controllers, identifiers or supervisors; its source is not trusted."""
    if change.role == "supervisor":
        return change.kind == "start" or change.kind in COMMANDS
    if change.role not in ("controller", "identifier"):
        return False
    controller = case.controllers[change.index]
    if change.role == "identifier" and controller.scheme != "indirect":
        return False
    if change.kind not in ("parameter", "weights"):
        return change.kind in ("start", "arm", "disarm")
    table = kind_of(controller).parameters
    try:
        if change.kind == "weights":
            with_weights(controller, Weights.model_validate(change.value))
            return True
        check_parameter("", change.name, change.value, table, sizes(controller))
    except (InputError, TypeError, ValueError):  # ValueError, TypeError: neither number nor text
        return False
    return True


def _disarmed(changes: Sequence[RunChange]) -> list[Absence]:
    """Intervals in which controllers and identifiers were disarmed, in the form of `Record.absences`."""
    absences = []
    for run_change in [change for change in changes if change.role != "supervisor"]:
        if run_change.kind == "disarm" or (run_change.kind == "start" and run_change.value == "disarmed"):
            whose = [other for other in changes if (other.role, other.index) == (run_change.role, run_change.index)]
            later = [other.tick for other in whose if other.kind in ("arm", "start")]
            end = min([tick for tick in later if tick > run_change.tick], default=np.iinfo(np.int64).max)
            absences.append(Absence(run_change.role, run_change.index, run_change.tick, end))
    return absences
