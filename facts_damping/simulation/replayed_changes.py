"""What was changed under way in controllers and identifiers, in a replay: at its tick, as it was recorded."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.case.controllers import check_parameter, sizes
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError
from facts_damping.monitors import COMMANDS
from facts_damping.simulation.changes import ask, set_parameter
from facts_damping.simulation.restarts import restore
from facts_damping.supervision.model import begin

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.signals import Record
    from facts_damping.simulation.tick import ControlSystem


class ReplayedChanges:
    """What was changed under way in controllers, identifiers, supervisors, and when they were not there, or silent.

    Of controllers that are of the kind that was recorded; where there was nothing of that, it does nothing.
    """

    def __init__(self, case: Case, record: Record, control: ControlSystem) -> None:
        """`control`: controllers, identifiers and supervisors, as built."""
        before = record.configuration.get("controllers") or []
        same = {c for c, one in enumerate(case.controllers) if c < len(before) and before[c].get("name") == one.name}
        own = [one for one in record.changes if one["index"] in same and _possible(case, one)]
        self._case, self._control = case, control
        self._changes = list(own)  # by tick; those before the first one are known of late recordings, too
        starts = any(one["kind"] == "start" and one["role"] != "supervisor" for one in own)
        self._fresh = deepcopy(control) if starts else control
        self._silent = [one for one in record.absences if one["role"] != "link" and one["index"] in same]
        self._silent += _disarmed(own)
        self._kept: list[tuple[NDArray[Any], NDArray[Any]]] = []

    def begin(self, tick: int) -> None:
        """What acts from a tick on; what a silent identifier must not tell its controller is kept as it is."""
        while self._changes and self._changes[0]["tick"] <= tick:
            one = self._changes.pop(0)
            if one["role"] == "supervisor":
                self._oversee(one)
            elif one["kind"] == "start":
                self._begin_again(one["role"], one["index"])
            elif one["kind"] == "parameter":
                set_parameter(self._case, self._control.bank, self._control.identifiers, one)
        state = self._control.bank_state
        told = (state.jacobian, state.compensated.change, state.compensated.change_ns)
        silent = [one["index"] for one in self._silent if one["role"] == "identifier" and _within(one, tick)]
        self._kept = [(array[c : c + 1], array[c : c + 1].copy()) for c in silent for array in told]

    def end(self) -> None:
        """Put back what was kept."""
        for array, before in self._kept:
            array[:] = before

    def said(self, role: str, rows: NDArray[Any]) -> NDArray[Any]:
        """Rows, of controllers or of identifiers, without those that were not said."""
        keep = np.ones(len(rows), np.bool_)
        for one in self._silent:
            if one["role"] == role:
                keep &= ~(_within(one, rows["tick"]) & (rows["controller"] == one["index"]))
        return np.asarray(rows[keep])

    def _oversee(self, change: dict[str, Any]) -> None:
        """What a supervisor was asked, or that it began again."""
        made, state = self._control.supervisors, self._control.supervisor_state
        own = list(made.settings["controller"])
        if change["kind"] == "start" and change["index"] in own:
            begin(state, own.index(change["index"]))
        else:
            ask(made, state, change)

    def _begin_again(self, role: str, c: int) -> None:
        """A controller, or its identifier, as at the start of a run."""
        now, fresh = self._control, self._fresh
        if role == "controller":
            restore(now.bank_state, fresh.bank_state, c)
            now.bank.settings[c] = fresh.bank.settings[c]
        else:
            place = list(now.identifiers.controller).index(c)
            restore(now.identifier_state, fresh.identifier_state, place)
            now.identifiers.settings[place] = fresh.identifiers.settings[place]


def _within(absence: dict[str, Any], tick: Any) -> Any:
    """Whether a tick, or each of several, is in an absence."""
    return (tick >= absence["first"]) & (tick < absence["end"])


def _possible(case: Case, change: dict[str, Any]) -> bool:
    """Whether a change can be one of a controller or an identifier of a case: anybody may have said it."""
    if change["role"] == "supervisor":
        return change["kind"] == "start" or change["kind"] in COMMANDS
    if change["role"] not in ("controller", "identifier"):
        return False
    controller = case.controllers[change["index"]]
    if change["role"] == "identifier" and controller.scheme != "indirect":
        return False
    if change["kind"] != "parameter":
        return change["kind"] in ("start", "arm")
    table = kind_of(controller).parameters
    try:
        check_parameter("", change["name"], change["value"], table, sizes(controller))
    except (InputError, TypeError, ValueError):  # the latter of what is neither number nor text
        return False
    return True


def _disarmed(changes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """From when to when nodes were disarmed, as `Record.absences` has it."""
    found = []
    for one in changes:
        if one["kind"] == "start" and one["value"] == "disarmed":
            whose = [other for other in changes if (other["role"], other["index"]) == (one["role"], one["index"])]
            later = [other["tick"] for other in whose if other["kind"] in ("arm", "start")]
            end = min([tick for tick in later if tick > one["tick"]], default=np.iinfo(np.int64).max)
            found.append({**one, "first": one["tick"], "end": end})
    return found
