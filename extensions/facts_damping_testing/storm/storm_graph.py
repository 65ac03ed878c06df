"""The graph of a storm while it runs: its processes, its time, and what is done to it."""

from __future__ import annotations

import errno
import os
import signal
import sys
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from facts_damping.nodes.launching import processes
from facts_damping.signals import to_ns
from facts_damping_testing.loopback.processes import process

if TYPE_CHECKING:
    from collections.abc import Callable

    from typing_extensions import Self

    from facts_damping.case.model import Case
    from facts_damping_testing.foreign.outsider import Outsider
    from facts_damping_testing.loopback.processes import Process, World
    from facts_damping_testing.storm.model import Storm

STARTS_S = 0.05  # world time in which nodes start on an idle machine: -1 to 0 for events
STALLED_S = 3.0  # world time at the start after which events do not wait for the first tick
PATIENCE_S = 1.5  # longest wait of a node for its peers at the start
BUFFER = 8192  # bytes that a file buffers
MARK = 0.7310585786300049  # of the limit: forged setpoints; no controller computes it
LINES = ("nodes/recorder.py", "recording/writer.py")  # files whose lines count for a signal at a line
ERRORS = {"full": errno.ENOSPC, "read-only": errno.EROFS}


class Done(NamedTuple):
    """What was done to a graph: world time in s, tick, kind of event, its node, in words."""

    world_s: float
    tick: int
    kind: str
    node: str
    text: str


@dataclass
class StormGraph:
    """The graph of a storm."""

    world: World
    storm: Storm
    case: Case
    foreign: Case  # the same with keys that are not the graph's
    outsider: Outsider = field(init=False)
    running: dict[str, processes.Process] = field(default_factory=dict)  # newest of each name
    asked: list[tuple[str, bool]] = field(default_factory=list)  # nodes to start: again after their end, or once more
    ever: list[tuple[str, Process, IO[bytes], IO[bytes]]] = field(default_factory=list)  # with copies of their files
    late_s: dict[str, float] = field(default_factory=dict)  # by node: how much later it starts
    at_line: dict[str, int] = field(default_factory=dict)  # by node: number of lines after which it gets SIGTERM
    attacks: list[list[Any]] = field(default_factory=list)  # what, topic, seed, messages left
    timeline: list[Done] = field(default_factory=list)
    killed: set[int] = field(default_factory=set)  # process numbers
    overdue: bool = False  # the graph did not end by itself
    memory: list[tuple[int, int]] = field(default_factory=list)  # tick, and memory blocks in use, in the second half
    tick_at: tuple[int, int] = (-1, 0)  # newest tick, and the world's time at which it came

    def time_s(self) -> float:
        """Simulated time, s: of the newest tick, and what has passed since; negative while the nodes start."""
        now = self.world.now_ns
        if self.outsider.newest < 0:
            since = 1e-9 * now
            return min(since / STARTS_S - 1.0, -1e-9) if since < STALLED_S else since - STALLED_S
        if self.outsider.newest > self.tick_at[0]:
            self.tick_at = self.outsider.newest, now
        return self.tick_at[0] / self.case.run.frame_rate + 1e-9 * (now - self.tick_at[1])

    def process(self, name: str) -> Process | None:
        """A running process of the graph."""
        program: Any = self.running[name].process if name in self.running else None
        return program if program is not None and program.exitcode is None else None

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a node, if it runs."""
        if program := self.process(name):
            self.world.signal(program.pid, number)
            if program.killed:
                self.killed.add(program.pid)

    def later(self, after_s: float, act: Callable[[], Any]) -> None:
        """Do something after a time."""
        self.world.at(self.world.now_ns + to_ns(after_s), act)

    def launched(self, name: str, launched_process: processes.Process) -> processes.Process:
        """Take note of a node that is started, and let it start late if an event says so."""
        program: Any = launched_process.process
        self.running[name] = launched_process
        files = [os.fdopen(os.dup(file.fileno()), "rb") for file in (launched_process.output, launched_process.errors)]
        self.ever.append((name, program, files[0], files[1]))
        program.busy_until_ns = self.world.now_ns + to_ns(self.late_s.pop(name, 0.0))
        if line := self.at_line.pop(name, 0):
            program.at_begin = lambda: sys.settrace(_at_line(program, line))
        return launched_process

    def look(self, _tick: int, members: dict[str, processes.Process]) -> None:
        """Start nodes that events ask for, as the program that runs the graph does: while it does not end it."""
        while self.asked:
            name, again = self.asked.pop(0)
            if name in members and again:
                processes.start_again(members, name)
            elif name in members and members[name].again:
                members[f"second {name} {len(members)}"] = processes.start(*members[name].again)
                self.running[name] = members[name]  # events happen to the first one


def _at_line(program: Process, line: int) -> Callable[..., Any]:
    """A trace function that sends SIGTERM at a line of the recorder's files, counted as they are executed."""
    left = [line]

    def trace(frame: Any, event: str, _: Any) -> Any:
        if not frame.f_code.co_filename.endswith(LINES):
            return None
        if event == "line":
            left[0] -= 1
            if left[0] == 0:
                sys.settrace(None)
                program.world.signal(program.pid, signal.SIGTERM)
        return trace

    return trace


class Disk:
    """A file on a disk that may be full or read-only, as its process says; a killed process loses what it buffers."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._buffer = file, bytearray()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        """Write; to a full disk half of it."""
        if what := process().values.get("disk"):
            if what == "full":
                self._file.write(data[: len(data) // 2])
            raise disk_error(what)
        self._buffer += data
        if len(self._buffer) > BUFFER:
            self.flush()
        return len(data)

    def flush(self) -> None:
        """Write what is buffered."""
        if not process().killed:
            self._file.write(bytes(self._buffer))
            self._file.flush()
        self._buffer.clear()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()
        self._file.close()


def disk_error(what: str) -> OSError:
    """Error of the system for a disk that is full or read-only."""
    return OSError(ERRORS[what], os.strerror(ERRORS[what]))
