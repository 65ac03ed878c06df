"""Controllers that are users' programs run in processes of their own while a case is simulated.

The simulation stays in this process, which is trusted. In it a `Proxy` stands for each class and FMU: at each step it
sends what the controller may know, and gets the setpoints. Each run, also a twin of a case, has a new process.

The process knows a `child.KnownSpec`, and then time, signals, their ages, and which are new. It also knows the time of
day. So who scores draws at random the order in which cases are run, and the seed that all cases have in common.
"""

from __future__ import annotations

import json
import pickle
import signal
import sys
import time
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from facts_damping.control.table import kind_of
from facts_damping.errors import FactsDampingError, InputError, RunError
from facts_damping.parameters.run import Controller
from facts_damping.simulation.programs.spec import spec_of
from facts_damping_studies.score.isolation import messages
from facts_damping_studies.score.isolation.processes import Connection, template
from facts_damping_studies.score.isolation.readable import Readable, file_of_fmu, imported, libraries, readable_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.simulation.programs.spec import Spec

    Floats = NDArray[np.float64]


class Limits(NamedTuple):
    """What a controller may take, of wall time and of memory."""

    build_s: float = 30.0
    step_s: float = 10.0
    run_s: float = 300.0  # all steps of a run
    memory: int = 4 << 30  # bytes of address space


LIMITS = Limits()
FORBIDDEN_CALL = "asked the kernel for a thread, a process, a signal or another process's memory"
KNOWN = ("name", "signals", "devices", "limits", "rates", "frame_rate", "seed", "parameters")  # of a `Spec`
UNASKED = "answered what it was not asked"
BUILDING = "as it was built"
CONTROLLER = "controller"  # parameter of a proxy: the index of the controller that it stands for


class Child(NamedTuple):
    """What the process of a controller has done in a run."""

    name: str
    computing: float  # time of processor over the run's simulated time
    slowest_s: float  # longest step, s of time of processor
    breach: str  # what it did that is not allowed; empty: nothing
    waiting: float = 0.0  # wall time in which the run waited for it over simulated time
    read: tuple[str, ...] = ()  # files beside its own that it read as it was built
    plant: bool = False  # whether it read the linearised plant


class BreachError(RunError):
    """A controller did what it may not; `sentence`: what."""

    def __init__(self, where: str, name: str, sentence: str) -> None:
        super().__init__(f"{where}: {name} {sentence}; allowed: what a controller may that is scored")
        self.sentence = f"{name} {sentence}"


def breach_of(error: BaseException) -> str:
    """What a controller did that ended a run with an error; empty if it is another error."""
    return error.sentence if isinstance(error, BreachError) else ""


@contextmanager
def isolated(case: Case, seed: int) -> Iterator[tuple[Case, list[Child]]]:
    """The case with its users' programs in processes of their own, for runs and twins within the block.

    The list is filled at the block's end: for each run, a `Child` for each of these controllers. `seed`: from which
    those of the controllers are made, instead of the case's. A run raises `BreachError` (`breach_of`) if a controller
    does what it may not, otherwise the errors that it would raise without isolation.
    """
    known = replace(case, run=case.run.model_copy(update={"seed": seed}))
    isolation = _Isolation(known)
    rows = [
        controller.model_copy(update={"policy": PROXY, "fmu": None, "parameters": {CONTROLLER: float(c)}})
        if kind_of(controller).program
        else controller
        for c, controller in enumerate(case.controllers)
    ]
    children: list[Child] = []
    token = _isolation.set(isolation)
    try:
        yield replace(case, controllers=rows), children
    except FactsDampingError as error:
        if isolation.failure is None:
            raise
        raise isolation.failure from error
    finally:
        _isolation.reset(token)
        for c in list(isolation.running):
            isolation.end(c)
        children.extend(isolation.children)


@cache
def confinement() -> tuple[str, ...]:
    """By what the processes of controllers are confined on this platform, such as `Landlock 7` and `seccomp`."""
    connection = template().fork([], None)
    begin = messages.Begin("/", list(sys.path), None, "", {}, Readable(libraries(), (), (), ()), LIMITS.memory)
    connection.send(pickle.dumps(begin), LIMITS.build_s)
    content = connection.receive(LIMITS.build_s)
    connection.close()
    template().end(connection.process)
    if content[:1] != messages.CONFINED:
        raise RunError(f"processes of controllers cannot be confined: {content[1:].decode(errors='replace')}")
    return tuple(json.loads(content[1:]))


class _Isolation:
    """Processes of the controllers of a case: those that run, and what those of earlier runs have done."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.running: dict[int, _Isolated] = {}
        self.children: list[Child] = []
        self.failure: FactsDampingError | None = None
        self.spec = cache(lambda c: spec_of(case, c))

    def begin(self, c: int) -> _Isolated:
        """A new process for controller c; the one of the run before ends."""
        if c in self.running:
            self.end(c)
        self.running[c] = _Isolated(self, c)
        self.running[c].build()
        return self.running[c]

    def end(self, c: int) -> None:
        """End the process of controller c."""
        self.children.append(self.running.pop(c).end())


_isolation: ContextVar[_Isolation] = ContextVar("_isolation")


class _Isolated:
    """A controller in a process of its own, in one run."""

    def __init__(self, isolation: _Isolation, c: int) -> None:
        self._isolation, self._case, self._c = isolation, isolation.case, c
        self._controller = self._case.controllers[c]
        self._where = f"controllers.{c}.{kind_of(self._controller).own}"
        self._spec: Spec = isolation.spec(c)
        self._devices, self._t_s = len(self._spec.devices), 0.0
        self._cpu_s = self._built_s = self._slowest_s = self._waited_s = 0.0
        self._asked_plant, self._breach, self._read = False, "", list[str]()
        self._status: int | None = None
        fmu = None if self._controller.fmu is None else str(file_of_fmu(self._controller).resolve())
        self._readable = readable_of(self._controller)
        self._connection: Connection = template().fork(imported(self._controller.policy), fmu)

    def build(self) -> None:
        """Have the process confine itself and make the controller; raises `FactsDampingError`."""
        spec, until = self._spec, time.monotonic() + LIMITS.build_s
        facts = {name: getattr(spec, name) for name in KNOWN}
        begin = messages.Begin(
            str(Path.cwd()),
            list(sys.path),
            Controller(policy=self._controller.policy, fmu=self._controller.fmu),  # without its link and faults
            self._where,
            facts,
            self._readable,
            LIMITS.memory,
        )
        self._ask(pickle.dumps(begin), BUILDING, LIMITS.build_s)
        confined = self._answer(BUILDING, LIMITS.build_s, messages.CONFINED)
        if tuple(json.loads(confined)) != (held := confinement()):
            self._fail(RunError(f"{self._where}: confined by {confined.decode()}, not by all of {', '.join(held)}"))
        ready = self._answer(BUILDING, until - time.monotonic(), messages.READY)
        self.once_a_tick, self._read = json.loads(ready)
        self._cpu_s = self._built_s = self._connection.cpu_s()

    def step(self, t_s: float, y: Floats, age_s: Floats, fresh: NDArray[np.bool_]) -> Floats:
        """Setpoints, (devices,), p.u.; arguments as of a user's own class."""
        when, self._t_s = f"in step of {self._controller.name} at {t_s:.6g} s", t_s
        began = time.monotonic()
        patience_s = min(LIMITS.step_s, LIMITS.run_s - self._waited_s)
        if self._connection.unread():  # it could go on, while the run does, with what it answers next
            self._fail_by(f"{UNASKED} ({when})")
        asked = messages.step_content(t_s, y, age_s, fresh)
        self._ask(asked, when, patience_s)
        answer = self._answer(when, patience_s, messages.SETPOINTS)
        token, content = answer[: messages.TOKEN], answer[messages.TOKEN :]
        if token != asked[-messages.TOKEN :]:  # of another step
            self._fail_by(f"{UNASKED} ({when})")
        self._waited_s += time.monotonic() - began
        before, self._cpu_s = self._cpu_s, self._connection.cpu_s()
        self._slowest_s = max(self._slowest_s, self._cpu_s - before)
        if len(content) != 8 * self._devices:
            self._fail_by("answered what are no setpoints")
        return np.frombuffer(content, np.float64)

    def end(self) -> Child:
        """End the process; returns what it has done."""
        spent_s = max(self._connection.cpu_s(), self._cpu_s) - self._built_s
        unasked = self._connection.unread() if self._status is None else b""
        if self._end_process() == -signal.SIGSYS and not self._breach:
            self._breach = f"{self._controller.name} {FORBIDDEN_CALL}"
        elif unasked and self._isolation.failure is None:
            said = unasked[messages.LENGTH.size :]
            refused = said[1:].decode(errors="replace") if said[:1] == messages.BREACH else UNASKED
            self._breach = f"{self._controller.name} {refused}"
        simulated_s = max(self._t_s, 1.0 / self._spec.frame_rate)
        computing, waiting = spent_s / simulated_s, self._waited_s / simulated_s
        done = self._controller.name, computing, self._slowest_s, self._breach, waiting
        return Child(*done, tuple(self._read), self._asked_plant)

    def _ask(self, content: bytes, when: str, patience_s: float) -> None:
        try:
            self._connection.send(content, patience_s)
        except TimeoutError:
            self._fail_by(f"took no message within {patience_s:.3g} s ({when})")
        except OSError:
            pass  # it has ended: what it last said is still to be read

    def _answer(self, when: str, patience_s: float, kind: bytes) -> bytes:
        """The next answer of a kind."""
        try:
            content = self._connection.receive(max(patience_s, 0.0))
        except TimeoutError:
            self._fail_by(f"did not answer within {patience_s:.3g} s: slow thinking ({when})")
        except ValueError as error:
            self._fail_by(f"answered {error}")
        said, rest = content[:1], content[1:]
        if said == kind:
            return rest
        if said == messages.PLANT and not self._asked_plant and kind != messages.CONFINED:
            self._asked_plant = True
            self._ask(pickle.dumps(self._spec.plant), when, patience_s)
            return self._answer(when, patience_s, kind)
        text = rest.decode(errors="replace")
        if said == messages.ERROR:
            built = kind == messages.SETPOINTS
            self._fail(RunError(f"{self._where}: {text}, {when}") if built else InputError(text))
        if said == messages.BREACH:
            self._fail_by(f"{text} ({when})")
        if said:
            self._fail_by(f"answered what is no answer ({when})")
        return self._fail_ended(when)

    def _fail_ended(self, when: str) -> NoReturn:
        self._cpu_s = max(self._cpu_s, self._connection.cpu_s())
        status = self._end_process()
        if status == -signal.SIGSYS:
            self._fail_by(f"{FORBIDDEN_CALL} ({when})")
        how = f"signal {-status}" if status < 0 else f"status {status}"
        error = f"{self._where}: the process of {self._controller.name} has ended by {how}, {when}"
        self._fail(RunError(error))

    def _end_process(self) -> int:
        """End the process, once; returns its exit status."""
        if self._status is None:
            self._connection.close()
            self._status = template().end(self._connection.process)
        return self._status

    def _fail_by(self, sentence: str) -> NoReturn:
        error = BreachError(self._where, self._controller.name, sentence)
        self._breach = error.sentence
        self._fail(error)

    def _fail(self, error: FactsDampingError) -> NoReturn:
        self._isolation.failure = error
        raise error


class Proxy:
    """Stands for a controller in a process of its own."""

    def __init__(self, spec: Any) -> None:
        self._isolated = _isolation.get().begin(int(spec.parameters[CONTROLLER]))
        self.once_a_tick = self._isolated.once_a_tick

    def step(self, t_s: float, y: Floats, age_s: Floats, fresh: NDArray[np.bool_]) -> Floats:
        """Setpoints of the controller, (devices,), p.u."""
        return self._isolated.step(t_s, y, age_s, fresh)


PROXY = f"{Proxy.__module__}:{Proxy.__qualname__}"
