"""Runs a storm: the graph on a loopback, with its events, and returns what was seen of it."""

from __future__ import annotations

import io
import sys
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import IO, TYPE_CHECKING, Any

from facts_damping.case.loading import make_case
from facts_damping.case.names import controller_addresses
from facts_damping.errors import FactsDampingError, RunError, check_known, one_line
from facts_damping.nodes import clock
from facts_damping.nodes.base import weights_file
from facts_damping.nodes.launching import graph, processes
from facts_damping.nodes.launching.starting import COCKPIT, PLANT, POLL_S, started
from facts_damping.nodes.recorder import topics
from facts_damping.output import writing
from facts_damping.parameters.security import add_key
from facts_damping.recording import reader, writer
from facts_damping.signals import to_ns
from facts_damping_testing.foreign import own_controller
from facts_damping_testing.loopback.opening import opened
from facts_damping_testing.loopback.processes import process
from facts_damping_testing.storm.choices import nodes
from facts_damping_testing.storm.conducting import conduct, do
from facts_damping_testing.storm.events import KINDS
from facts_damping_testing.storm.storm_graph import PATIENCE_S, Disk, Done, StormGraph, disk_error

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path
    from types import ModuleType

    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping_testing.loopback.processes import World
    from facts_damping_testing.storm.model import Event, Storm

TIMEOUT_S = 2.0  # of the nodes, for silent ones
LIMIT_S = 180.0  # world time beyond its duration after which a storm is broken off; longer than all its waits
AFTER_S = 1.0  # world time that a free graph goes on without its plant


@dataclass
class NodeEnd:
    """How a node ended: exit status, its output and errors, and whether the storm killed it."""

    name: str
    status: int | None
    output: str
    errors: str
    killed: bool


@dataclass
class Trace:
    """What is known of a graph after its run; of one on DDS the record alone."""

    case: Case
    mode: str
    record: Record | None = None
    unreadable: str = ""  # why there is no record
    storm: Storm | None = None
    reason: str = ""  # why the graph ended early; empty: it ended as planned
    overdue: bool = False  # it did not end by itself
    world_s: float = 0.0
    nodes: list[NodeEnd] = field(default_factory=list)
    logs: list[tuple[int, str, int, str]] = field(default_factory=list)  # ns, node, severity, text
    timeline: list[Done] = field(default_factory=list)
    sent: dict[str, int] = field(default_factory=dict)  # foreign messages that the recorder received, by topic
    lost: set[str] = field(default_factory=set)  # nodes that messages to were lost
    longest_queue: int = 0
    memory: list[tuple[int, int]] = field(default_factory=list)  # tick, and memory blocks in use, of a long storm

    @property
    def events(self) -> Sequence[Event]:
        """The storm's events; none on DDS."""
        return [] if self.storm is None else self.storm.events


def case_of(storm: Storm, folder: Path, keys: str = "keys.yaml") -> Case:
    """The case of a storm; its keys are in the folder. Raises `InputError`."""
    run = dict(storm.run)
    if storm.signed:
        if not (folder / keys).exists():
            add_key(folder / keys)
        run["security"] = {"keys": str(folder / keys)}
    return make_case(run, f"storm {storm.seed}")


def run(storm: Storm, folder: Path) -> Trace:
    """Run a storm; the graph's files are in a new folder. Raises `InputError` if the storm is none."""
    case = case_of(storm, folder)
    _check(storm, case)
    trace = Trace(case, storm.mode, storm=storm)
    with opened(storm.seed) as world:
        foreign = case_of(storm, folder, "other_keys.yaml") if storm.signed else case
        storm_graph = _prepared(world, storm, case, foreign)
        with _watched(storm_graph):
            last_s = max([0.0, *(one.at for one in storm.events)])  # a plant may be paused until then
            world.at(to_ns(LIMIT_S + last_s + case.ticks / case.run.frame_rate), lambda: _break_off(storm_graph))
            failed = io.StringIO()
            world.start("outsider", partial(conduct, storm_graph), (), {}, failed, failed)
            _start_own(storm_graph)
            try:
                _run_graph(storm_graph, folder / "graph")
            except FactsDampingError as error:
                trace.reason = one_line(error)
        if failed.getvalue():
            raise RunError(f"storm {storm.seed}: {failed.getvalue()}")
        trace.world_s = 1e-9 * world.now_ns
        trace.logs, trace.lost, trace.longest_queue = world.logs, world.middleware.lost, world.longest_queue
    trace.timeline, trace.sent, trace.overdue = storm_graph.timeline, storm_graph.outsider.sent, storm_graph.overdue
    trace.nodes, trace.memory = _ends(storm_graph), storm_graph.memory
    try:
        trace.record = reader.load(folder / "graph" / "recording")
    except FactsDampingError as error:
        trace.unreadable = one_line(error)
    return trace


def _check(storm: Storm, case: Case) -> None:
    """Raise `InputError` for an event of an unknown kind, node or topic."""
    allowed = {"kind": list(KINDS), "node": ["", *nodes(case)], "topic": ["", "setpoints", *topics(case)]}
    for i, event in enumerate(storm.events):
        for field_, known in allowed.items():
            check_known(f"events.{i}.{field_}", getattr(event, field_), known)


def _prepared(world: World, storm: Storm, case: Case, foreign: Case) -> StormGraph:
    """The graph of a storm with the storm's middleware, and the events that concern the start of nodes."""
    middleware = world.middleware
    middleware.seed, middleware.discovery_ns = storm.seed, to_ns(storm.discovery)
    middleware.lease_ns = to_ns(storm.lease)
    storm_graph = StormGraph(world, storm, case, foreign)
    for event in storm.events:
        if KINDS[event.kind].starts:
            do(storm_graph, event)
    return storm_graph


def _start_own(storm_graph: StormGraph) -> None:
    """Start the user's own nodes, which a graph waits for; whether they survive is the user's affair."""
    for address, controller in zip(controller_addresses(storm_graph.case), storm_graph.case.controllers, strict=True):
        if controller.external:
            arguments = ["--ros-args", "-r", f"__node:={address.name}"]
            storm_graph.world.start(str(address), own_controller.main, arguments, {}, sys.stdout, io.StringIO())


def _run_graph(storm_graph: StormGraph, out: Path) -> None:
    """Run the graph to its end."""
    if storm_graph.storm.mode != "free":
        graph.run(storm_graph.case, storm_graph.storm.mode, out, lambda _done, _of: None, TIMEOUT_S, storm_graph.look)
        return
    out.mkdir(parents=True)
    with started(storm_graph.case, "free", out, TIMEOUT_S) as running:
        while running[PLANT].process.exitcode is None:
            storm_graph.look(0, running)
            clock.sleep(POLL_S)
        clock.sleep(AFTER_S)


def _break_off(storm_graph: StormGraph) -> None:
    storm_graph.overdue = True
    for one in storm_graph.world.processes[1:]:
        one.kill()


@contextmanager
def _watched(storm_graph: StormGraph) -> Iterator[None]:
    """Take note of each node that starts; let its disk fail when an event says so."""
    start, open_new, whole = processes.start, writer._open_new, writing.write_whole  # noqa: SLF001 (the place to fail)

    def watched(name: str, module: str, parameters: dict[str, Any], *given: Any) -> processes.Process:
        given_s = {} if module == COCKPIT else {"start_timeout": PATIENCE_S}
        made: processes.Process = start(name, module, {**parameters, **given_s}, *given)
        return storm_graph.launched(name, made)

    def write_whole(path: Path, text: str) -> None:
        if what := process().values.get("disk"):
            raise disk_error(what)
        if not process().killed:
            whole(path, text)

    def opened_new(file: Path) -> Any:
        if what := process().values.get("disk"):
            with writer.writing(file):
                raise disk_error(what)
        return Disk(open_new(file))

    with (
        _replaced(processes, "start", watched),
        _replaced(writer, "_open_new", opened_new),
        _replaced(writer, "write_whole", write_whole),
        _replaced(weights_file, "write_whole", write_whole),
    ):
        yield


@contextmanager
def _replaced(module: ModuleType, name: str, function: Callable[..., Any]) -> Iterator[None]:
    """Another function in a module's place of this name."""
    usual = getattr(module, name)
    setattr(module, name, function)
    try:
        yield
    finally:
        setattr(module, name, usual)


def _ends(storm_graph: StormGraph) -> list[NodeEnd]:
    found = []
    for name, own, output, errors in storm_graph.ever:
        said, failed = _text(output), _text(errors)
        found.append(NodeEnd(name, own.exitcode, said, failed, own.pid in storm_graph.killed or not own.began))
    return found


def _text(file: IO[bytes]) -> str:
    with file:
        file.seek(0)
        return file.read().decode(errors="replace")
