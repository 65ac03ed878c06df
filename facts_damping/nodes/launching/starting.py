"""The nodes of a graph: which there are, in which order they start and stop, and the weights that they leave."""

from __future__ import annotations

import signal
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.names import (
    acting,
    controller_addresses,
    controller_names,
    identifier_addresses,
    identifier_names,
    link_addresses,
    recorded_topic,
    setpoint_senders,
    supervisor_addresses,
)
from facts_damping.control.table import kind_of
from facts_damping.nodes import clock
from facts_damping.nodes.launching import processes
from facts_damping.nodes.launching.processes import Process, end, start_command
from facts_damping.output.writing import write_whole
from facts_damping.parameters.files import read_table
from facts_damping.parameters.yaml_text import dump

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from facts_damping.case.model import Case

POLL_S = 0.02
PLANT, STREAMS, REPLAYED = "plant_sim", "c37118_client", "replay_source"
SOURCES = (PLANT, STREAMS, REPLAYED)  # sources of frames, one per graph; a replayed recording also replaces the links
RECORDER = "recorder"  # stopped last, to receive all messages of the others
VIEW, COCKPIT = VIEWS = "live_view", "cockpit"  # they only listen
RUN_FILE = "run.yaml"  # in the folder of a graph: the run that its nodes read
START_S = 60.0  # longest wait for a live view to start


class Cockpit(NamedTuple):
    """A cockpit for a graph: host and port of its server, and what is told its address."""

    host: str
    port: int
    tell: Callable[[str], object]


class Parts(NamedTuple):
    """What a graph has besides the nodes of its case, and in place of some of them."""

    view_port: int | None = None  # of a live view for Foxglove
    cockpit: Cockpit | None = None  # a page in a browser
    replayed: Path | str | None = None  # a recording in place of plant and links
    streams: str | None = None  # in place of the plant, in real time (facts_damping_streams.parameters.read_streams)
    environment: Mapping[str, str] | None = None  # of the nodes; None: that of this process
    watched: bool = False  # by a cockpit that was started before, for several graphs
    endless: bool = False  # until it is stopped, whatever its duration


ALONE = Parts()  # the nodes of the case, and no others


@contextmanager
def started(case: Case, mode: str, out: Path, timeout: float, parts: Parts = ALONE) -> Iterator[dict[str, Process]]:
    """Start the nodes of a case; at exit, stop the source first and the recorder last.

    `out`: folder of the run file and the recording; `timeout`: longest wait for a silent node, s.
    """
    run_file = out / RUN_FILE
    unsigned = {} if parts.replayed is None else {"security": None}  # a recording has no keys
    run_file.write_text(dump(case.document() | unsigned), encoding="utf-8")
    common = {"run": run_file, "mode": mode, "timeout": timeout, "recorder": True, "endless": parts.endless}
    common["view"] = parts.watched or parts.view_port is not None or parts.cockpit is not None
    running: dict[str, Process] = {}

    def begin(name: str, node: str, parameters: dict[str, Any], remaps: Mapping[str, str] | None = None) -> None:
        running[name] = processes.start(name, node, parameters, remaps, parts.environment)

    try:
        if parts.view_port is not None:
            begin(VIEW, VIEW, {"run": run_file, "port": parts.view_port})
            wait_for_view(running[VIEW])
        if parts.cockpit is not None:
            more = {"launched": mode == "realtime", "recording": out / "recording"}
            begin(COCKPIT, COCKPIT, {"run": run_file, "host": parts.cockpit.host, "port": parts.cockpit.port, **more})
            parts.cockpit.tell(wait_for_view(running[COCKPIT]))
        begin(RECORDER, RECORDER, {**common, "output": out / "recording"})
        for c, address in enumerate(controller_addresses(case)):
            if case.controllers[c].command is not None:
                running[str(address)] = start_command(case, c, out, parts.environment)
        _begin_nodes(begin, case, common, out, replays=parts.replayed is not None)
        begin(*_source(parts, common))
        yield running
    finally:
        stop(running)
        for process in running.values():
            process.output.close()
            process.errors.close()
        save_weights(case, out)


def _begin_nodes(begin: Callable[..., None], case: Case, common: dict[str, Any], out: Path, *, replays: bool) -> None:
    """Start links, controllers, identifiers and supervisors, without the user's own nodes.

    `replays`: a recording replaces the links, and identifiers receive the recorded setpoints.
    """
    addresses = enumerate(controller_addresses(case))
    senders = setpoint_senders(case)
    for node, nodes in (
        ("wan_link", {} if replays else dict(enumerate(link_addresses(case)))),
        ("controller", {c: address for c, address in addresses if not kind_of(case.controllers[c]).node}),
        ("identifier", identifier_addresses(case)),
        ("supervisor", supervisor_addresses(case)),
    ):
        for i, address in nodes.items():
            saved = {"save": _part(out, address.name)} if node in ("controller", "identifier") else {}
            remaps = {}
            if replays and node == "identifier":
                topic = senders[acting(case, i)].topic
                remaps = {f"/{topic}": f"/{recorded_topic(topic)}"}
            begin(str(address), node, {**common, "index": i, **saved}, remaps)


def _source(parts: Parts, common: dict[str, Any]) -> tuple[str, str, dict[str, Any]]:
    """Name, node and parameters of the source of frames."""
    if parts.replayed is not None:
        return REPLAYED, REPLAYED, {**common, "recording": parts.replayed}
    if parts.streams is not None:
        return STREAMS, STREAMS, {**common, "streams": parts.streams}
    return PLANT, PLANT, common


def stop(running: dict[str, Process]) -> None:
    """Stop the source, then the other nodes together (they take their last messages first), then the recorder."""
    first = [process for name, process in running.items() if name in SOURCES]
    last = [process for name, process in running.items() if name == RECORDER]
    for together in (first, [process for process in running.values() if process not in (*first, *last)], last):
        end(together, signal.SIGINT)


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


def wait_for_view(view: Process) -> str:
    """Wait until a live view or a cockpit serves. Returns its address. If it ends later, the graph goes on."""
    deadline = clock.monotonic() + START_S
    while not (address := view.read()):
        if view.process.exitcode is not None or clock.monotonic() > deadline:
            end([view], signal.SIGINT)
            raise view.failure()
        clock.sleep(POLL_S)
    return address.strip()
