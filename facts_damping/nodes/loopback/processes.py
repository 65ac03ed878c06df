"""Processes that are threads of this process: one runs at a time, until it waits; time is simulated.

A waiting process gives a condition and a time. The next process whose wait is over runs, in a fixed order. If all wait,
time goes on to the earliest of these times.
"""

from __future__ import annotations

import contextvars
import signal
import sys
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from facts_damping.signals import NEVER
from facts_damping.terminal import INTERRUPTIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

FIRST_PID = 2**30  # more than any process of the system has
STEP_NS = 100_000  # minimum time of a wait, about as with DDS
BEGINS_NS = 1_700_000_000_000_000_000  # wall time at the start, ns since 1970
current: contextvars.ContextVar[Process | None] = contextvars.ContextVar("current", default=None)


def process() -> Process:
    """The process that runs."""
    found = current.get()
    if found is None:
        raise RuntimeError("no loopback in this thread")
    return found


def world() -> World:
    """The world of the process that runs."""
    return process().world


def wall_ns() -> int:
    """Wall time, ns since 1970."""
    return BEGINS_NS + world().now_ns


class Killed(BaseException):
    """Ends a process that was killed."""


def never() -> bool:
    """Condition of a process that waits only for a time."""
    return False


@dataclass(eq=False)
class Process:
    """A process: its surroundings, and what it waits for."""

    world: World
    name: str
    arguments: list[str]
    environment: Mapping[str, str]
    output: Any
    errors: Any
    pid: int
    exitcode: int | None = None
    handlers: dict[int, Any] = field(default_factory=dict)  # of signals
    values: dict[str, Any] = field(default_factory=dict)  # of the middleware
    at_end: list[Callable[[], Any]] = field(default_factory=list)  # called when it ends
    turn: threading.Semaphore = field(default_factory=lambda: threading.Semaphore(0))
    ready: Callable[[], bool] = never
    until_ns: int = 0
    stopped: bool = False  # by SIGSTOP
    killed: bool = False

    def join(self, timeout: float | None = None) -> None:
        until = NEVER if timeout is None else self.world.now_ns + int(timeout * 1e9)
        self.world.wait(lambda: self.exitcode is not None, until)

    def kill(self) -> None:
        self.killed = True

    def is_alive(self) -> bool:
        return self.exitcode is None


class World:
    """All processes and their time."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.main = Process(self, "main", list(sys.argv), {}, sys.stdout, sys.stderr, 0)
        self.processes = [self.main]
        self._token = current.set(self.main)

    def close(self) -> None:
        for process in self.processes[1:]:
            process.killed = True
        while any(process.exitcode is None for process in self.processes[1:]):
            self.wait(never, self.now_ns)
        current.reset(self._token)

    def start(
        self,
        name: str,
        run: Callable[[], Any],
        arguments: Sequence[str],
        environment: Mapping[str, str],
        output: Any,
        errors: Any,
    ) -> Process:
        """Start a process; it first runs when another one waits."""
        pid = FIRST_PID + len(self.processes)
        process = Process(self, name, [name, *arguments], dict(environment), output, errors, pid)
        process.until_ns = self.now_ns
        self.processes.append(process)
        threading.Thread(target=self._run, args=(process, run), daemon=True, name=name).start()
        return process

    def _run(self, process: Process, run: Callable[[], Any]) -> None:
        process.turn.acquire()
        current.set(process)
        status: Any = 0
        try:
            if not process.killed:
                run()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        except Killed:
            status = -9
        except BaseException as error:  # noqa: BLE001 (as a process would end)
            process.errors.write(f"{type(error).__name__}: {error}\n")
            status = 1
        for close in process.at_end:
            close()
        process.exitcode = -9 if process.killed else status
        process.ready, process.until_ns = never, NEVER
        self._next(process).turn.release()

    def wait(self, ready: Callable[[], bool], until_ns: int) -> None:
        """Let others run until `ready` returns true or until a time."""
        process = current.get() or self.main
        self.now_ns += STEP_NS  # a process that polls sees time pass
        process.ready, process.until_ns = ready, until_ns
        chosen = self._next(process)
        if chosen is not process:
            chosen.turn.release()
            process.turn.acquire()
        if process.killed and process is not self.main:
            raise Killed

    def _next(self, process: Process) -> Process:
        """The process that runs after another one, in the order of their starts; time goes on if all wait."""
        at = self.processes.index(process) + 1
        order = [one for one in self.processes[at:] + self.processes[:at] if one.exitcode is None]
        while True:
            for one in order:
                if one.killed or (not one.stopped and (one.until_ns <= self.now_ns or one.ready())):
                    return one
            self.now_ns = min((one.until_ns for one in order if not one.stopped), default=NEVER)
            if self.now_ns == NEVER:
                raise RuntimeError(f"all wait for each other: {', '.join(one.name for one in order)}")

    def signal(self, pid: int, number: int) -> None:
        process = next((one for one in self.processes[1:] if one.pid == pid and one.exitcode is None), None)
        if process is None:
            raise ProcessLookupError(pid)
        if number == signal.SIGKILL:
            process.killed = True
        elif number in (signal.SIGSTOP, signal.SIGCONT):
            process.stopped = number == signal.SIGSTOP
        elif callable(handler := process.handlers.get(number)):
            handler(number, None)
        elif number in INTERRUPTIONS:
            process.killed = True
