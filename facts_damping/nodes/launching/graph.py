"""Runs a case as a ROS 2 graph: starts the nodes as processes, watches and stops them, and cleans up."""

from __future__ import annotations

import os
import re
import shutil
import signal
import tempfile
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.names import (
    acting,
    controller_addresses,
    controller_names,
    identifier_addresses,
    identifier_names,
    link_addresses,
    recorded_topic,
    replaceable,
    setpoint_senders,
    supervisor_addresses,
)
from facts_damping.control.table import kind_of
from facts_damping.errors import InputError, RunError
from facts_damping.interruption import clean_up_first
from facts_damping.nodes import clock
from facts_damping.nodes.launching import forked
from facts_damping.nodes.launching.commands import Command, command
from facts_damping.parameters.files import new_folder, read_table
from facts_damping.parameters.security import read_keys
from facts_damping.parameters.yaml_text import dump
from facts_damping.simulation.policies import StepTimes
from facts_damping.terminal import write_whole

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from multiprocessing.process import BaseProcess

    from facts_damping.case.model import Case

POLL_S = 0.02
PLANT, STREAMS, REPLAYED = "plant_sim", "c37118_client", "replay_source"
SOURCES = (PLANT, STREAMS, REPLAYED)  # sources of frames, one per graph; a replayed recording also replaces the links
RECORDER = "recorder"  # stopped last, to receive all messages of the others
VIEW, COCKPIT = VIEWS = "live_view", "cockpit"  # they only listen
RUN_FILE = "run.yaml"  # in the folder of a graph: the run that its nodes read
START_S = 60.0  # longest wait for a live view to start
STOP_S = 15.0  # longest wait for a node to stop
MAX_DOMAIN = 232

# Nodes log to /rosout and write lines to this process; ROS 2 leaves no log files behind.
QUIET = ("--ros-args", "--disable-stdout-logs", "--disable-external-lib-logs")
ENVIRONMENT = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}  # unless the user says otherwise


REFUSED = re.compile(r"^refused (\d+) (\S+) (\S+) (\S+)$", re.MULTILINE)  # line of a node: count, cause, topic, source
Refusals = dict[tuple[str, str, str, str], int]  # counts by node, cause, topic and source


@dataclass
class Outcome:
    """Result of a graph: recording, duration, counts."""

    recording: Path
    wall_s: float
    ticks: int  # that the source of frames has published
    deadline_misses: int
    messages_lost: int
    messages_refused: Refusals
    fallen: list[str]  # reasons of nodes that ended before the run, in real time
    step_times: dict[str, StepTimes]  # of controllers that are the user's own programs


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

    def progress(self) -> list[tuple[int, int, int]]:
        """Progress lines since the last call: tick, number of ticks, deadline misses."""
        lines = re.findall(r"^tick (\d+) (\d+) (\d+)$", self.read(), re.MULTILINE)
        return [(int(k), int(n), int(misses)) for k, n, misses in lines]

    def text(self) -> str:
        """All of its output."""
        self.output.seek(0)
        return self.output.read().decode(errors="replace")

    def refused(self) -> Refusals:
        """Refusals of its message filter so far."""
        return {(self.name, *how): int(count) for count, *how in REFUSED.findall(self.text())}

    def step_times(self) -> StepTimes | None:
        """Step times of its program; None: it runs none or has not reported."""
        line = re.search(r"^steps (\d+) (\S+) (\S+) (\S+)$", self.text(), re.MULTILINE)
        return StepTimes(int(line[1]), *map(float, line.groups()[1:])) if line else None

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
        lines = self._errors()
        code = self.process.exitcode
        if code is not None and code < 0:
            return f"{self.name} was killed by {signal.Signals(-code).name}"
        if lines and isinstance(self.process, Command):
            return f"{self.name} ended with exit status {code}: {lines[-1]}"
        return lines[-1] if lines else f"{self.name} ended with exit status {code}"


def start(
    name: str,
    module: str,
    parameters: dict[str, Any],
    remaps: Mapping[str, str] | None = None,
    environment: Mapping[str, str] | None = None,
) -> Process:
    """Start a node as a process in a session of its own; `name`: relative to the graph, with namespace.

    `remaps`: topic remappings; `environment`: None: that of this process.
    """
    namespace, _, own = name.rpartition("/")
    arguments = [*QUIET, "-r", f"__node:={own}"]
    arguments += ["-r", f"__ns:=/{namespace}"] if namespace else []
    for topic, other in (remaps or {}).items():
        arguments += ["-r", f"{topic}:={other}"]
    for key, value in {**parameters, "progress": True}.items():
        arguments += ["-p", f"{key}:={str(value).lower() if isinstance(value, bool) else value}"]
    output, errors = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115 (closed in `graph`)
    # Files without names: they vanish with this process, however it ends.
    names = (f"/proc/{os.getpid()}/fd/{file.fileno()}" for file in (output, errors))
    process = forked.start(module, arguments, {**ENVIRONMENT, **(environment or os.environ)}, *names)
    return Process(name, process, output, errors, (name, module, parameters, remaps, environment))


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


def check_commands(case: Case) -> None:
    """Raise `InputError` if the program of a user's own node does not exist."""
    for c, controller in enumerate(case.controllers):
        if controller.command is not None and shutil.which(controller.command[0]) is None:
            text = f"controllers.{c}.command: '{controller.command[0]}' given"
            raise InputError(f"{text}; allowed: an executable program")


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


def _stop(running: dict[str, Process]) -> None:
    """Stop the source, then the other nodes together (they take their last messages first), then the recorder."""
    first = [process for name, process in running.items() if name in SOURCES]
    last = [process for name, process in running.items() if name == RECORDER]
    for processes in (first, [one for one in running.values() if one not in (*first, *last)], last):
        end(processes, signal.SIGINT)


def _part(out: Path, name: str) -> Path:
    return out / f"{name}.part.yaml"


def save_weights(case: Case, out: Path) -> None:
    """Merge the saved weights of each controller and its identifier into one file per controller."""
    identifiers = identifier_names(case)
    for i, name in enumerate(controller_names(case)):
        weights: dict[str, Any] = {}
        for path in (_part(out, node) for node in (name, identifiers.get(i)) if node is not None):
            if path.is_file():
                weights |= {key: value for key, value in read_table(path).items() if value is not None}
                path.unlink(missing_ok=True)
        if weights:
            write_whole(out / f"{name}.weights.yaml", dump(weights))


def _wait_for_view(view: Process) -> str:
    """Wait until a live view or a cockpit serves. Returns its address. If it ends later, the graph goes on."""
    deadline = clock.monotonic() + START_S
    while not (address := view.read()):
        if view.process.exitcode is not None or clock.monotonic() > deadline:
            end([view], signal.SIGINT)
            raise view.failure()
        clock.sleep(POLL_S)
    return address.strip()


class Cockpit(NamedTuple):
    """A cockpit for a graph: host and port of its server, and what is told its address."""

    host: str
    port: int
    tell: Callable[[str], object]


def obey(running: dict[str, Process], allowed: Collection[str]) -> None:
    """Carry out the lines `kill NODE` and `restart NODE` of the cockpit, for nodes that may be replaced.

    A node that has ended starts again, disarmed. A user's own program, and a node that still runs, are not started.
    """
    for order, name in re.findall(r"^(kill|restart) (\S+)$", running[COCKPIT].read(), re.MULTILINE):
        node = running.get(name) if name in allowed else None
        if node is None:
            continue
        if order == "kill" and node.process.exitcode is None:
            node.process.kill()
        elif order == "restart":
            start_again(running, name)


def start_again(running: dict[str, Process], name: str) -> None:
    """Start a node that has ended once more, with `join`; the ended one is kept for its counts."""
    node = running[name]
    if node.process.exitcode is not None and node.again:
        own, module, parameters, remaps, environment = node.again
        running[f"{name} {len(running)}"] = node
        running[name] = start(own, module, {**parameters, "join": True}, remaps, environment)


@contextmanager
def graph(
    case: Case,
    mode: str,
    out: Path,
    timeout: float,
    view_port: int | None = None,
    replayed: Path | str | None = None,
    streams: str | None = None,
    environment: Mapping[str, str] | None = None,
    cockpit: Cockpit | None = None,
) -> Iterator[dict[str, Process]]:
    """Start the nodes of a case; at exit, stop the source first and the recorder last. Arguments: as of `run`.

    In a replay, identifiers receive the recorded setpoints.
    """
    run_file = out / RUN_FILE
    unsigned = {} if replayed is None else {"security": None}  # a recording has no keys
    run_file.write_text(dump(case.document() | unsigned), encoding="utf-8")
    common = {"run": run_file, "mode": mode, "timeout": timeout, "recorder": True}
    common["view"] = view_port is not None or cockpit is not None
    senders = setpoint_senders(case)
    running: dict[str, Process] = {}

    def begin(name: str, module: str, parameters: dict[str, Any], remaps: Mapping[str, str] | None = None) -> None:
        running[name] = start(name, module, parameters, remaps, environment)

    try:
        if view_port is not None:
            begin(VIEW, VIEW, {"run": run_file, "port": view_port})
            _wait_for_view(running[VIEW])
        if cockpit is not None:
            more = {"launched": mode == "realtime", "recording": out / "recording"}
            begin(COCKPIT, COCKPIT, {"run": run_file, "host": cockpit.host, "port": cockpit.port, **more})
            cockpit.tell(_wait_for_view(running[COCKPIT]))
        begin(RECORDER, RECORDER, {**common, "output": out / "recording"})
        controllers = dict(enumerate(controller_addresses(case)))
        for c in [c for c in controllers if kind_of(case.controllers[c]).node]:
            address = controllers.pop(c)
            if case.controllers[c].command is not None:
                running[str(address)] = start_command(case, c, out, environment)
        for module, nodes in (
            ("wan_link", dict(enumerate(link_addresses(case))) if replayed is None else {}),
            ("controller", controllers),
            ("identifier", identifier_addresses(case)),
            ("supervisor", supervisor_addresses(case)),
        ):
            for i, node in nodes.items():
                own = {"index": i} | ({"save": _part(out, node.name)} if module in ("controller", "identifier") else {})
                remaps = {}
                if replayed is not None and module == "identifier":
                    topic = senders[acting(case, i)].topic
                    remaps = {f"/{topic}": f"/{recorded_topic(topic)}"}
                begin(str(node), module, {**common, **own}, remaps)
        if replayed is not None:
            begin(REPLAYED, REPLAYED, {**common, "recording": replayed})
        elif streams is not None:
            begin(STREAMS, STREAMS, {**common, "streams": streams})
        else:
            begin(PLANT, PLANT, common)
        yield running
    finally:
        _stop(running)
        for process in running.values():
            process.output.close()
            process.errors.close()
        save_weights(case, out)


def run(
    case: Case,
    mode: str,
    out: Path,
    progress: Callable[[int, int], None],
    timeout: float = 5.0,
    view_port: int | None = None,
    replayed: Path | str | None = None,
    streams: str | None = None,
    look: Callable[[int, dict[str, Process]], None] | None = None,
    environment: Mapping[str, str] | None = None,
    cockpit: Cockpit | None = None,
) -> Outcome:
    """Run a case as a graph of processes; the recording is `out / "recording"`.

    `view_port`: of a live view for Foxglove; None: without. `replayed`: a recording that replaces plant and links;
    `streams`: replaces the plant, in real time (parameters.streams.read_streams).
    `look`: called repeatedly while the plant runs, with the newest tick that it has reported and the nodes by name.
    `environment`: of the nodes; None: that of this process. `cockpit`: a page in a browser; None: without.
    In real time a run that has begun goes on if a link, controller, supervisor or identifier ends.

    Raises `RunError` naming the node that ended or is silent, `InputError` if the folder is in use.
    """
    clean_up_first("what was recorded by then is readable")
    check_domain((environment or os.environ).get("ROS_DOMAIN_ID", "0"))
    if (out / "recording").exists():
        raise InputError(f"--out {out}: holds a recording already; allowed: a new folder")
    check_commands(case)
    if case.run.security is not None and replayed is None:
        read_keys(Path(case.run.security.keys))
    new_folder(out)
    began = clock.monotonic()
    misses, fallen = 0, dict[str, str]()
    with graph(case, mode, out, timeout, view_port, replayed, streams, environment, cockpit) as running:
        plant = next(running[name] for name in SOURCES if name in running)
        reported_s, newest = clock.monotonic() + 60.0, 0  # longer at the start than the nodes' own time-outs
        while plant.process.exitcode is None:
            for newest, n, late in plant.progress():
                misses = late
                # After tick 1 all have answered once.
                reported_s = clock.monotonic() if newest > 1 else max(reported_s, clock.monotonic())
                progress(newest, n)
            if look is not None:
                look(newest, running)
            if COCKPIT in running and mode == "realtime":
                obey(running, replaceable(case))
            _check_others(running, fallen if newest > 1 and mode == "realtime" else None)
            if clock.monotonic() - reported_s > timeout + 5.0:
                raise RunError(f"{plant.name} is silent: no progress within {timeout + 5.0:g} s")
            clock.sleep(POLL_S)
        if plant.failed():
            _check_others(running, fallen if newest > 1 and mode == "realtime" else None)
            raise plant.failure()
        for newest, n, late in plant.progress():
            misses = late
            progress(newest, n)
        # A node that ended earlier gives the reason, such as a second graph in the same domain.
        _check_others(running, fallen if mode == "realtime" else None)
        wall = clock.monotonic() - began
        _stop(running)
        recorder = running[RECORDER]
        if recorder.failed():
            raise recorder.failure()
        lost = re.search(r"^lost (\d+)$", recorder.read(), re.MULTILINE)
        times = {name.rpartition("/")[2]: process.step_times() for name, process in running.items()}
        step_times = {name: row for name, row in times.items() if row is not None}
        refused = {how: count for process in running.values() for how, count in process.refused().items()}
    missed = int(lost.group(1)) if lost else 0
    return Outcome(out / "recording", wall, newest, misses, missed, refused, list(fallen.values()), step_times)


def check_domain(domain: str) -> None:
    """Raise `InputError` for a ROS_DOMAIN_ID for which DDS has no ports."""
    if not (domain.isdecimal() and int(domain) <= MAX_DOMAIN):
        raise InputError(f"ROS_DOMAIN_ID: '{domain}' given; allowed: 0 to {MAX_DOMAIN}")


def _check_others(running: dict[str, Process], fallen: dict[str, str] | None = None) -> None:
    """Raise `RunError` if a node other than the source has ended; a killed node counts as the cause.

    `fallen`: if given, takes the reasons of ended nodes, and the run goes on; except if the recorder has ended.
    """
    ended = [p for name, p in running.items() if name not in (*SOURCES, *VIEWS) and p.process.exitcode is not None]
    if fallen is not None:
        fallen |= {p.name: p.reason() for p in ended if p.name != RECORDER}
        ended = [p for p in ended if p.name == RECORDER]
    if ended:
        killed = [p for p in ended if (p.process.exitcode or 0) < 0]
        raise (killed or ended)[0].failure()
