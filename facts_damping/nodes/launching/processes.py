"""Nodes as processes: they are started, read, and ended."""

from __future__ import annotations

import os
import signal
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

from facts_damping.case.names import controller_addresses, controller_names
from facts_damping.errors import RunError
from facts_damping.nodes.base import lines
from facts_damping.nodes.launching import forked
from facts_damping.nodes.launching.commands import Command, command
from facts_damping.simulation.programs.policies import StepTimes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from multiprocessing.process import BaseProcess
    from pathlib import Path

    from facts_damping.case.model import Case

STOP_S = 15.0  # longest wait for a node to stop

# Nodes log to /rosout and write lines to this process; ROS 2 leaves no log files behind.
QUIET = ("--ros-args", "--disable-stdout-logs", "--disable-external-lib-logs")
ENVIRONMENT = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}  # unless the user says otherwise

Refusals = dict[tuple[str, str, str, str], int]  # counts by node, cause, topic and source


@dataclass
class Process:
    """A running node and its output files."""

    name: str
    process: BaseProcess | Command
    output: IO[bytes]
    errors: IO[bytes]
    again: tuple[Any, ...] = ()  # arguments of `start`; empty: a user's own program
    read_bytes: int = 0  # of the output so far

    def read(self) -> str:
        """Output since the last call."""
        self.output.seek(self.read_bytes)
        data = self.output.read()
        self.read_bytes += len(data)
        return data.decode(errors="replace")

    def failed(self) -> bool:
        """Whether its exit status is not 0; also true while it runs."""
        return self.process.exitcode != 0

    def progress(self) -> list[lines.Ticks]:
        """Progress since the last call."""
        return lines.ticks(self.read())

    def text(self) -> str:
        """All of its output."""
        self.output.seek(0)
        return self.output.read().decode(errors="replace")

    def refused(self) -> Refusals:
        """Refusals of its message filter so far."""
        return {(self.name, *how): count for how, count in lines.refusals(self.text())}

    def step_times(self) -> StepTimes | None:
        """Step times of its program; None: it runs none or has not reported."""
        times = lines.steps(self.text())
        return None if times is None else StepTimes(*times)

    def failure(self) -> RunError:
        """Reason as an error, with the preceding error lines as details."""
        error = RunError(self.reason())
        error.details = "\n".join(self._errors()[:-1])
        return error

    def _errors(self) -> list[str]:
        self.errors.seek(0)
        return self.errors.read().decode(errors="replace").strip().splitlines()

    def reason(self) -> str:
        """Why the node ended, in one line."""
        errors = self._errors()
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"{self.name} was killed by {signal.Signals(-code).name}"
        if errors and isinstance(self.process, Command):
            return f"{self.name} ended with exit status {code}: {errors[-1]}"
        return errors[-1] if errors else f"{self.name} ended with exit status {code}"


def start(
    name: str,
    node: str,
    parameters: dict[str, Any],
    remaps: Mapping[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
) -> Process:
    """Start a node as a process in a session of its own; `name`: relative to the graph, with namespace.

    `node`: its kind, the name of its executable; `remaps`: topic remappings; `environment`: None: that of this process.
    """
    namespace, _, node_name = name.rpartition("/")
    arguments = [*QUIET, "-r", f"__node:={node_name}"]
    arguments += ["-r", f"__ns:=/{namespace}"] if namespace else []
    for topic, other in (remaps or {}).items():
        arguments += ["-r", f"{topic}:={other}"]
    for key, value in {**parameters, "progress": True}.items():
        arguments += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
    output, errors = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 (closed in `started`)
    # Files without names: they vanish with this process, however it ends.
    names = (f"/proc/{os.getpid()}/fd/{file.fileno()}" for file in (output, errors))
    process = forked.start(node, arguments, {**ENVIRONMENT, **(environment or os.environ)}, *names)
    return Process(name, process, output, errors, (name, node, parameters, remaps, environment))


def start_command(case: Case, c: int, out: Path, environment: Mapping[str, str] | None = None) -> Process:
    """Start a user's own node by its command; its output goes into a file beside the recording."""
    name = str(controller_addresses(case)[c])
    path = out / f"{controller_names(case)[c]}.log"
    path.write_bytes(b"")
    log = path.open("a+b")  # appends, wherever this process reads
    asked = command(case, c)
    try:
        process = Command(asked, {**ENVIRONMENT, **(environment or os.environ)}, log)
    except OSError as error:
        log.close()
        raise RunError(f"{name}: {asked[0]}: cannot be started: {error.strerror}") from error
    return Process(name, process, log, log)


def end(processes: Iterable[Process], number: int) -> None:
    """Stop processes, also suspended ones; kill those that do not end within `STOP_S`.

    `number`: signal for the user's own programs. Our nodes get SIGTERM: if this process was started with SIGINT ignored
    (by `&` in a script), a fork that is just starting would miss SIGINT.
    """
    running = [node.process for node in processes if node.process.exitcode is None]
    for process in running:
        for sent in (number if isinstance(process, Command) else signal.SIGTERM, signal.SIGCONT):
            with suppress(ProcessLookupError):  # it may have ended by now
                os.kill(process.pid or 0, sent)
    for process in running:
        process.join(STOP_S)
        if process.exitcode is None:
            process.kill()
            process.join()


def start_again(running: dict[str, Process], name: str) -> None:
    """Start a node that has ended once more, with `join`; the ended one is kept for its counts."""
    ended = running[name]
    if ended.process.exitcode is not None and ended.again:
        full_name, node, parameters, remaps, environment = ended.again
        running[f"{name} {len(running)}"] = ended
        running[name] = start(full_name, node, {**parameters, "join": True}, remaps, environment)
