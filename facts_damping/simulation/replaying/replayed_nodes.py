"""A replay node by node: each controller, supervisor and identifier acts on the messages it had received when it acted.

`Record.latest` tells which those were. In real time nodes may receive messages of each other late. In lockstep, and
where a recording does not tell, a node uses estimate and setpoints of the tick before, and a supervisor its own tick.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.control.bank import act, controller_network, set_estimate
from facts_damping.control.identifier import identify, store_setpoints, write_estimates
from facts_damping.neurofuzzy.learning import write_learning
from facts_damping.signals import ESTIMATE, LEARNING, SETPOINT, SUPERVISION, Span
from facts_damping.simulation.assembly import identifier_network
from facts_damping.simulation.loop import control_system, setpoint_buffer
from facts_damping.simulation.measured_plant import tick_ns
from facts_damping.simulation.programs.policies import check, connect
from facts_damping.simulation.replaying.replayed_changes import ReplayedChanges
from facts_damping.simulation.restarts import Restarts
from facts_damping.supervision.model import SUPERVISOR
from facts_damping.supervision.step import controller_health, supervise, write_status

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.neurofuzzy.network import Network
    from facts_damping.record import Record

EMPTY = {"issued": SETPOINT, "estimates": ESTIMATE, "supervised": SETPOINT, "supervision": SUPERVISION}
KEPT = 36_000  # ticks for which results are kept; no node uses older ones
INNER = ("finite", "norm", "lyapunov", "fall")  # fields of SUPERVISOR: its controller's health


class Played(NamedTuple):
    """Output of a case's controllers, identifiers and supervisors in a replay."""

    issued: NDArray[Any]  # SETPOINT
    estimates: NDArray[Any]  # ESTIMATE
    supervised: NDArray[Any]  # SETPOINT
    supervision: NDArray[Any]  # SUPERVISION
    learning: NDArray[Any]  # LEARNING, absent nodes included


class Estimate(NamedTuple):
    """An identifier's estimate in a tick: arguments of `set_estimate`."""

    jacobian: NDArray[np.float64]
    change: NDArray[np.float64]
    measured_ns: int


class NewMessages:
    """Which messages are new to a node in each tick: as recorded, else as in lockstep."""

    def __init__(self, record: Record) -> None:
        self._newest = {key: dict(rows.tolist()) for key, rows in record.latest.items()}
        self._tells = {key[:2] for key in record.latest}
        self._used: dict[tuple[str, int, str], int] = {}
        self._begun = {(change.role, change.index, change.tick) for change in record.changes if change.kind == "start"}

    def new(self, role: str, index: int, what: str, tick: int, usual: int) -> range:
        """Ticks of the messages that are new at a tick; `usual`: tick of the newest message, if not recorded.

        A node that starts during the run receives only the newest of the earlier messages.
        """
        key = role, index, what
        if key not in self._newest and key[:2] in self._tells:
            return range(0)
        newest = self._newest.get(key, {}).get(tick, usual)
        begins = (role, index, tick) in self._begun
        before = newest - 1 if begins else self._used.get(key, -1)
        self._used[key] = max(self._used.get(key, -1), newest, tick - 1 if begins else -1)
        return range(max(0, before + 1), newest + 1)


class NodeReplay:
    """The nodes of a case that act on measurements, and their output so far."""

    def __init__(
        self, case: Case, record: Record, delivered: list[list[NDArray[Any]]], acting: list[NDArray[Any]]
    ) -> None:
        """`delivered`: by link and tick (DELIVERY); `acting`: setpoints that went down the links, by tick."""
        self._case, self._record, self._delivered, self._acting = case, record, delivered, acting
        maximum = max(len(rows) for link in delivered for rows in link)
        self._control = control_system(case, maximum)
        self._out, self._devices = self._control.issued, record.devices[0]
        self._programs = connect(case, self._control.bank_state)
        self._changed = ReplayedChanges(case, record, self._control)
        self._restarts = Restarts(self._control.bank, self._control.bank_state)
        self._messages = NewMessages(record)
        self._place = {int(tick): at for at, tick in enumerate(record.ticks)}
        self._networks = {(c, 0): controller_network(row) for c, row in enumerate(case.controllers) if row.scheme}
        self._networks |= {(c, 1): identifier_network(case.controllers[c]) for c in self._identified()}
        self._issued: dict[tuple[int, int], NDArray[Any]] = {}  # by controller and tick, as the next two
        self._inner: dict[tuple[int, int], NDArray[Any]] = {}
        self._estimates: dict[tuple[int, int], Estimate] = {}
        self._rows: dict[str, list[NDArray[Any]]] = {name: [] for name in Played._fields}

    def _identified(self) -> list[int]:
        return [int(c) for c in self._control.identifiers.controller]

    def tick(self, at: int, tick: int) -> None:
        """Run a tick of all nodes that were there; `at`: its index in the record."""
        self._changed.begin(tick)
        self._restarts.begin(tick)
        idle = self._changed.idle
        for c in range(len(self._case.controllers)):
            if not idle("issued", c, tick):
                self._act(c, at, tick)
        check(self._programs)
        for s, c in enumerate(self._control.supervisors.settings["controller"].tolist()):
            if not idle("supervised", c, tick):
                self._supervise(s, at, tick)
        for n, c in enumerate(self._identified()):
            if not idle("estimates", c, tick):
                self._identify(n, c, at, tick)
        for results in (self._issued, self._inner, self._estimates):
            for c in range(len(self._case.controllers)):
                results.pop((c, tick - KEPT), None)

    def played(self) -> Played:
        """The output so far, without that of absent or silent nodes (learning rows: all)."""
        whole = {
            name: np.concatenate(parts) if parts else np.zeros(0, EMPTY.get(name, LEARNING))
            for name, parts in self._rows.items()
        }
        return Played(**(whole | {name: self._changed.published(name, whole[name]) for name in EMPTY}))

    def _act(self, c: int, at: int, tick: int) -> None:
        control, rows = self._control, self._delivered[self._case.used_links[c]][at]
        for newer in self._messages.new("controller", c, "estimate", tick, tick - 1):
            if (c, newer) in self._estimates and not self._changed.silent("estimates", c, newer):
                set_estimate(control.bank_state, c, *self._estimates[c, newer])
        count = act(control.bank, control.bank_state, c, tick, rows, len(rows), self._out, 0)
        self._issued[c, tick] = self._out[:count].copy()
        self._rows["issued"].append(self._issued[c, tick])
        health = np.zeros(1, SUPERVISOR)
        controller_health(control.bank, control.bank_state, c, health, 0)
        self._inner[c, tick] = health
        state = control.bank_state
        self._learning(c, 0, tick, state.learner.each[c], state.memory.lyapunov[c])

    def _learning(self, c: int, identifier: int, tick: int, learner: Any, lyapunov: NDArray[np.float64]) -> None:
        net: Network | None = self._networks.get((c, identifier))
        if net is not None:
            rows = np.zeros(net.outputs * (int(learner.group[-1]) + 1), LEARNING)
            write_learning(net, learner, lyapunov, tick, c, identifier, rows, 0)
            self._rows["learning"].append(rows)

    def _supervise(self, s: int, at: int, tick: int) -> None:
        """Run a supervisor with new setpoints, device states and controller health."""
        supervisors, state = self._control.supervisors, self._control.supervisor_state
        settings, row = supervisors.settings[s], state.rows[s]
        c, link = int(settings["controller"]), int(settings["link"])
        both = [c, *(i for i, controller in enumerate(self._case.controllers) if controller.fallback_of == c)]
        pairs = [(who, newer) for who in both for newer in self._new(c, f"controller {who}", tick)]
        latest = [pair for pair in pairs if pair in self._issued and not self._changed.silent("issued", *pair)]
        for newer in self._new(c, "state", tick):
            if (c, newer) in self._inner and not self._changed.absent("learning", c, newer):
                for name in INNER:
                    row[name] = self._inner[c, newer][name][0]
        ticks = [newer for newer in self._new(c, "plant", tick) if newer in self._place]
        if ticks:
            self._devices = self._record.devices[self._place[ticks[-1]]]
        issued = np.concatenate([*(self._issued[pair] for pair in latest), self._out[:0]])
        span = Span(tick, tick_ns(tick, int(settings["frame_rate"])), tick_ns(tick + 1, int(settings["frame_rate"])))
        inputs = self._delivered[link][at], issued, np.ascontiguousarray(self._devices)
        out = setpoint_buffer(len(self._case.controllers[c].devices), len(issued))  # a restart brings many at once
        count = supervise(supervisors, state, s, span, *inputs, out)
        self._rows["supervised"].append(out[:count])
        status = np.zeros(1, SUPERVISION)
        if write_status(supervisors, state, s, tick, status, 0):
            self._rows["supervision"].append(status)

    def _new(self, c: int, what: str, tick: int) -> range:
        return self._messages.new("supervisor", c, what, tick, tick)

    def _identify(self, n: int, c: int, at: int, tick: int) -> None:
        """Run an identifier: store the setpoints sent to the devices, then process the delivered entries."""
        identifiers, state = self._control.identifiers, self._control.identifier_state
        for newer in self._messages.new("identifier", c, "setpoints", tick, tick - 1):
            if newer in self._place:
                rows = self._acting[self._place[newer]]
                store_setpoints(identifiers, state, n, rows, len(rows))
        frames = self._delivered[self._case.used_links[c]][at]
        identify(identifiers, state, n, frames, len(frames))
        size = len(self._case.controllers[c].signals) * len(self._case.controllers[c].devices)
        rows = np.zeros(size, ESTIMATE)
        write_estimates(identifiers, state, n, tick, rows, 0)
        self._rows["estimates"].append(rows)
        estimate_fields = state.jacobian[n].copy(), state.change[n].copy(), int(state.held.newest_ns[n])
        self._estimates[c, tick] = Estimate(*estimate_fields)
        self._learning(c, 1, tick, state.learner.each[n], state.lyapunov[n])
