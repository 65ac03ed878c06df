"""Processes that are threads of this process: one runs at a time, until it waits; time is simulated.

A waiting process gives a condition and a time. The next process whose wait is over runs, in a fixed order or, with a
seed, in a random one. If all wait, time goes on to the earliest of these times.
"""

from __future__ import annotations

import contextvars
import heapq
import itertools
import random
import signal
import sys
import threading
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

from facts_damping.interruption import INTERRUPTIONS
from facts_damping.signals import NEVER
from facts_damping_testing.loopback.middleware import Middleware

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

FIRST_PID = 2**30  # more than any process of the system has
STEP_NS = 100_000  # minimum time of a wait, about as with DDS
BEGINS_NS = 1_700_000_000_000_000_000  # wall time at the start, ns since 1970
current: contextvars.ContextVar[Process | None] = contextvars.ContextVar("current", default=None)


def process() -> Process:
    """The process that runs."""
    running = current.get()
    if running is None:
        raise RuntimeError("no loopback in this thread")
    return running


def world() -> World:
    """The world of the process that runs."""
    return process().world


def wall_ns() -> int:
    """Wall time by the clock of the process that runs, ns since 1970."""
    return process().wall_ns()


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
    began: bool = False
    exitcode: int | None = None
    handlers: dict[int, Any] = field(default_factory=dict)  # of signals
    values: dict[str, Any] = field(default_factory=dict)  # of the middleware
    at_begin: Callable[[], Any] = never  # called when it begins
    at_end: list[Callable[[], Any]] = field(default_factory=list)  # called when it ends
    turn: SimpleQueue[None] = field(default_factory=SimpleQueue)  # whose it is, gets one
    ready: Callable[[], bool] = never
    until_ns: int = 0
    stopped_ns: int = NEVER  # when SIGSTOP suspended it, or when it was killed; NEVER: it may run
    killed: bool = False
    turn_ns: int = 0  # time that each of its turns takes: of a slow one
    busy_until_ns: int = 0  # it computes until then, and takes no turn
    clock_offset_ns: int = 0  # of its wall time

    @property
    def responds(self) -> bool:
        """Whether its middleware still answers others: it neither ended nor is suspended."""
        return self.exitcode is None and not self.killed and self.stopped_ns == NEVER

    def wall_ns(self) -> int:
        """Wall time by its clock, ns since 1970."""
        return BEGINS_NS + self.world.now_ns + self.clock_offset_ns

    def join(self, timeout: float | None = None) -> None:
        until = NEVER if timeout is None else self.world.now_ns + int(timeout * 1e9)
        self.world.wait(lambda: self.exitcode is not None, until)

    def kill(self) -> None:
        self.killed, self.stopped_ns = True, self.world.now_ns

    def is_alive(self) -> bool:
        return self.exitcode is None


class World:
    """All processes and their time."""

    def __init__(self, seed: int | None = None) -> None:
        """`seed`: of the order in which processes take turns, and of the time that these take; None: both are fixed."""
        self.now_ns = 0
        self._random = None if seed is None else random.Random(seed)
        self.middleware = Middleware()
        self.logs: list[tuple[int, str, int, str]] = []  # of nodes: time in ns, name, severity, text
        self.longest_queue = 0  # messages that waited for a process that responds
        self._actions: list[tuple[int, int, Callable[[], Any]]] = []  # time, number, action
        self._numbers = itertools.count()
        self.main = Process(self, "main", list(sys.argv), {}, sys.stdout, sys.stderr, 0)
        self.processes = [self.main]
        self._token = current.set(self.main)

    def at(self, time_ns: int, act: Callable[[], Any]) -> None:
        """Call `act` at a time, between two turns, in the thread of the process that just waits."""
        heapq.heappush(self._actions, (time_ns, next(self._numbers), act))

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

    def _run(self, program: Process, run: Callable[[], Any]) -> None:
        program.turn.get()
        current.set(program)
        program.at_begin()
        status: Any = 0
        try:
            if not program.killed:
                program.began = True
                run()
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else int(end.code is not None)
        except Killed:
            status = -9
        except BaseException as error:  # noqa: BLE001 (as a process would end)
            program.errors.write(f"{type(error).__name__}: {error}\n")
            status = 1
        for close in program.at_end:
            close()
        program.exitcode = -9 if program.killed else status
        program.ready, program.until_ns = never, NEVER
        self._next(program).turn.put(None)

    def wait(self, ready: Callable[[], bool], until_ns: int) -> None:
        """Let others run until `ready` returns true or until a time."""
        process = current.get() or self.main
        # A process that polls sees time pass.
        self.now_ns += STEP_NS if self._random is None else int(STEP_NS * self._random.expovariate(1.0)) + 1
        process.ready, process.until_ns = ready, until_ns
        process.busy_until_ns = max(process.busy_until_ns, self.now_ns + process.turn_ns)
        chosen = self._next(process)
        if chosen is not process:
            chosen.turn.put(None)
            process.turn.get()
        if process.killed and process is not self.main:
            raise Killed

    def _next(self, program: Process) -> Process:
        """The process that runs after another one, in the order of their starts; time goes on if all wait."""
        order = [peer for peer in self.processes if peer.exitcode is None]
        if (chance := self._random) is not None:
            order.sort(key=lambda _: chance.random())
        else:
            order.sort(key=lambda peer: peer.pid <= program.pid)
        while True:
            while self._actions and self._actions[0][0] <= self.now_ns:
                heapq.heappop(self._actions)[2]()
            for successor in order:
                if successor.killed or (
                    successor.responds and successor.busy_until_ns <= self.now_ns and self._is_due(successor)
                ):
                    return successor
            live = [waiting for waiting in order if waiting.responds]
            times = [max(waiting.until_ns, waiting.busy_until_ns) for waiting in live]
            times += [waiting.busy_until_ns for waiting in live if waiting.busy_until_ns > self.now_ns]
            self.now_ns = min([*times, *(row[0] for row in self._actions[:1])], default=NEVER)
            if self.now_ns == NEVER:
                raise RuntimeError(f"all wait for each other: {', '.join(waiting.name for waiting in order)}")

    def _is_due(self, program: Process) -> bool:
        return program.until_ns <= self.now_ns or program.ready()

    def signal(self, pid: int, number: int) -> None:
        process = next((peer for peer in self.processes[1:] if peer.pid == pid and peer.exitcode is None), None)
        if process is None:
            raise ProcessLookupError(pid)
        if number == signal.SIGKILL:
            process.kill()
        elif number in (signal.SIGSTOP, signal.SIGCONT):
            process.stopped_ns = self.now_ns if number == signal.SIGSTOP else NEVER
        elif callable(handler := process.handlers.get(number)):
            handler(number, None)
        elif number in INTERRUPTIONS:
            process.killed = True
