"""The command `cockpit`: a run in real time, or recordings, on a page in a browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.case import loading
from facts_damping.case.names import label
from facts_damping.cli.reporting import say, tell_graph
from facts_damping.cli.runs import WITH_RUN, is_recording, out_folder
from facts_damping.errors import InputError
from facts_damping.interruption import clean_up_first
from facts_damping.output.terminal import Progress, note, put
from facts_damping.output.writing import write_whole
from facts_damping.parameters import files
from facts_damping.simulation import loop
from facts_damping.simulation.replaying.replay import check_has_run

if TYPE_CHECKING:
    import argparse

    from facts_damping.record import Record
    from facts_damping_views.cockpit.application import Content


def cockpit(arguments: argparse.Namespace) -> None:
    """Start a graph with a cockpit, or serve recordings."""
    from facts_damping_views.cockpit import server

    server.check_libraries()
    if is_recording(arguments.what):
        _replay(arguments)
    elif arguments.other is not None:
        raise InputError(f"{arguments.other}: given beside a run; allowed: beside a recording")
    else:
        _run(arguments)


def _run(arguments: argparse.Namespace) -> None:
    from facts_damping.analysis import summary  # noqa: F401 (while what nodes need is loaded, too)
    from facts_damping.nodes.launching import forked, graph
    from facts_damping.nodes.launching.starting import Cockpit as GraphCockpit
    from facts_damping.nodes.launching.starting import Parts

    forked.load()
    case = loading.load_case(arguments.what, arguments.set, arguments.supervised)
    loop.build_loop(case, outside=True)  # refuses bad input before anything starts
    name = label(case.summary())
    folder = out_folder(arguments, name)

    def tell(address: str) -> None:
        say(arguments, f"cockpit: {address}")
        put("", flush=True)

    served = GraphCockpit(arguments.host, arguments.port, tell)
    with Progress(name) as progress:
        outcome = graph.run(case, "realtime", folder, progress, arguments.timeout, parts=Parts(cockpit=served))
    tell_graph(arguments, name, outcome, folder)


def _replay(arguments: argparse.Namespace) -> None:
    """Serve one or two recordings until interrupted."""
    from facts_damping.nodes.base.asyncio_thread import AsyncioThread
    from facts_damping.recording.reader import load
    from facts_damping_views.cockpit import server
    from facts_damping_views.cockpit.application import Cockpit

    if arguments.set or arguments.supervised is not None:
        problem = f"--set {arguments.set[0]}" if arguments.set else "--supervised"
        raise InputError(f"{problem}: given with a recording; allowed: with a run")
    paths = [recording for recording in (arguments.what, arguments.other) if recording is not None]
    records = []
    with Progress("read", "recordings") as progress:
        for i, path in enumerate(paths):
            progress(i, len(paths))
            records.append(load(path))
    shown = Cockpit(content(paths, records), host=arguments.host)
    serving = server.Server(shown, arguments.host, arguments.port)
    clean_up_first()
    thread = AsyncioThread()
    running = thread.begin(serving.serve())
    try:
        say(arguments, f"cockpit: {serving.address}")
        put("", flush=True)
        running.result()
    except KeyboardInterrupt:
        raise KeyboardInterrupt("the page is no longer served") from None
    finally:
        thread.close()  # a report that is being computed ends with it


def content(paths: list[str], records: list[Record]) -> Content:
    """What a cockpit shows of recordings, one panel each. Raises `InputError` for one without its run."""
    from facts_damping.findings import names
    from facts_damping_views.cockpit import layout, samples, words
    from facts_damping_views.cockpit.application import Content

    for path, record in zip(paths, records, strict=True):
        check_has_run(record, path, WITH_RUN)
    labels = names(records)
    panels, data, events = [], {}, {}
    for path, name, record in zip(paths, labels, records, strict=True):
        case = loading.recorded_case(record.configuration, path)
        panel = layout.panel(case, name)
        panels.append(panel.shown)
        data[name] = samples.of_record(case, panel, record).astype("<f4").tobytes()
        events[name] = words.of_record(case, record)
    end = max(float(record.time_s[-1]) for record in records)
    shown: dict[str, Any] = {"type": "layout", "title": ", ".join(labels), "mode": "replay", "panels": panels}
    return Content(shown | {"duration": end}, data, events, dict(zip(labels, map(str, paths), strict=True)))


def views(arguments: argparse.Namespace) -> None:
    """Write layouts for Foxglove and PlotJuggler of a run or recording, and the recording in simulated time."""
    from facts_damping.recording import in_simulated_time, origin
    from facts_damping_views.layouts import layouts

    path = Path(arguments.what or "")
    if is_recording(arguments.what):
        if arguments.set:
            raise InputError(f"--set {arguments.set[0]}: given with a recording; allowed: with a run")
        content, namespace = origin(path)
        case = loading.recorded_case(content, str(path))
        folder = path.parent / "views" if arguments.out is None else Path(arguments.out)
        for line in in_simulated_time(path, folder / "simulated_time"):
            note(f"{path}: {line}")
        say(arguments, f"recording: {folder / 'simulated_time'}")
    else:
        case, namespace = loading.load_case(arguments.what, arguments.set), "/"
        folder = files.new_folder(out_folder(arguments, "views"))
    for name, text in layouts(case, namespace).items():
        write_whole(folder / name, text)
        say(arguments, f"layout: {folder / name}")
