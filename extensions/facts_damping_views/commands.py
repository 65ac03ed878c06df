"""The command `cockpit`: a run in real time, or recordings, on a page in a browser."""

from __future__ import annotations

import re
from contextlib import contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.case import loading
from facts_damping.case.names import label, replaceable
from facts_damping.cli.reporting import say, tell_graph
from facts_damping.cli.runs import WITH_RUN, out_folder
from facts_damping.errors import FactsDampingError, InputError, one_line
from facts_damping.interruption import clean_up_first
from facts_damping.nodes import clock
from facts_damping.nodes.launching import forked, graph, processes, starting
from facts_damping.output.terminal import Progress, note, put
from facts_damping.output.writing import write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.bagfile import SUFFIXES
from facts_damping.simulation import loop
from facts_damping.simulation.replaying.replay import check_has_run
from facts_damping_views.cockpit import controls
from facts_damping_views.cockpit.reports import folder_of

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from facts_damping.case.model import Case
    from facts_damping.nodes.launching.graph import Outcome
    from facts_damping.record import Record
    from facts_damping_views.cockpit.application import Content


REPEATED_S = 600.0  # simulated time after which random numbers repeat in a run without end
ENDS = "Ctrl-C ends it"
DURATION = re.compile(r"\s*duration\s*=")
EVENT = re.compile(rf"^{controls.EVENT} (.*)$", re.MULTILINE)


def cockpit(arguments: argparse.Namespace) -> None:
    """Start a graph with a cockpit, or serve recordings."""
    from facts_damping_views.cockpit import server

    server.check_libraries()
    if _is_recording(arguments.what):
        _replay(arguments)
    elif arguments.other is not None:
        raise InputError(f"{arguments.other}: given beside a run; allowed: beside a recording")
    else:
        _run(arguments)


def _is_recording(what: str | None) -> bool:
    """Whether a command line names a recording, not a run."""
    path = Path(what or "")
    return what is not None and (path.is_dir() or path.suffix in SUFFIXES)


class SimulatedTime(Progress):
    """A progress line of simulated time; `end`: text behind it."""

    def __init__(self, label: str, rate: int, end: str) -> None:
        super().__init__(label)
        self._rate, self._end = rate, end

    def __str__(self) -> str:
        """The line."""
        return f"\r{self._label}: {self._done / self._rate:.0f} s{self._end}; {ENDS}\033[K"


class Page:
    """The process that serves the page, and what it has asked for."""

    def __init__(self, arguments: argparse.Namespace, process: processes.Process) -> None:
        self._arguments, self._process = arguments, process
        self.begun = self._again = False  # a run has begun; another one is asked for

    def look(self, case: Case, tick: int = 0, running: dict[str, processes.Process] | None = None) -> None:
        """Tell and carry out what the page has said since the last call; arguments as in `graph.run`."""
        self.begun |= tick > 0
        output = self._process.read()
        for text in EVENT.findall(output):
            say(self._arguments, text)
            put("", flush=True)
        self._again |= controls.AGAIN in output.splitlines()
        graph.obey(running or {}, replaceable(case), output)

    def wait(self, case: Case) -> None:
        """Wait until the page asks for another run. Raises `RunError` if its process has ended."""
        while not self._again:
            self.look(case)
            if self._process.process.exitcode is not None:
                raise self._process.failure()
            clock.sleep(starting.POLL_S)
        self._again = False


def _run(arguments: argparse.Namespace) -> None:
    """Start a graph with a page; start it again whenever the page asks for it, until interrupted."""
    from facts_damping.analysis import summary  # noqa: F401 (while what nodes need is loaded, too)

    forked.load()
    case, endless = live_case(arguments)
    loop.build_loop(case, outside=True)  # refuses bad input before anything starts
    name, parts = label(case.summary()), starting.Parts(watched=True, endless=endless)
    folder = out_folder(arguments, name)
    graph.check(case, folder, parts)
    place, end = files.new_folder(folder), "" if endless else f" of {case.duration:g} s"
    clean_up_first()
    try:
        with _page(arguments, case, folder) as page:
            say(arguments, f"the run {'has no end' if endless else f'takes {case.duration:g} s'}; {ENDS}")
            for number in count(1):
                place = folder_of(folder, number)
                with SimulatedTime(name, case.run.frame_rate, end) as progress:
                    more: Any = (progress, arguments.timeout, partial(page.look, case), parts)
                    _tell(arguments, page, name, partial(graph.run, case, "realtime", place, *more), place)
                say(arguments, f"again: the button on the page starts another run; {ENDS}")
                put("", flush=True)
                page.wait(case)
    except KeyboardInterrupt:
        recording = place / "recording"
        say(arguments, f"recording: {recording}", f"report: facts-damping analyze {recording} --report report.html")
        raise KeyboardInterrupt("the page is no longer served") from None


def live_case(arguments: argparse.Namespace) -> tuple[Case, bool]:
    """The case of a run, and whether it has no end; its duration is then that of its random numbers."""
    load = partial(loading.load_case, arguments.what, supervised=arguments.supervised)
    case, endless = load(sets=arguments.set), not any(DURATION.match(setting) for setting in arguments.set)
    if endless and case.duration < REPEATED_S:
        case = load(sets=[*arguments.set, f"duration={REPEATED_S:g}"])
    return case, endless


def _tell(arguments: argparse.Namespace, page: Page, name: str, run_graph: Callable[[], Outcome], folder: Path) -> None:
    """Run a graph and tell its results; an error of a run that has begun is told, too."""
    try:
        tell_graph(arguments, name, run_graph(), folder)
    except FactsDampingError as error:
        if not page.begun:
            raise
        note(f"facts-damping: {one_line(error)}")


@contextmanager
def _page(arguments: argparse.Namespace, case: Case, folder: Path) -> Iterator[Page]:
    """Serve the page, and tell its address."""
    run_file = folder / starting.RUN_FILE
    run_file.write_text(dump(case.document()), encoding="utf-8")
    more = {"launched": True, "again": True, "recording": folder / "recording"}
    parameters = {"run": run_file, "host": arguments.host, "port": arguments.port, **more}
    process = processes.start(starting.COCKPIT, starting.COCKPIT, parameters)
    try:
        say(arguments, f"cockpit: {starting.wait_for_view(process)}")
        yield Page(arguments, process)
    finally:
        starting.stop({starting.COCKPIT: process})
        process.output.close()
        process.errors.close()


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
    if _is_recording(arguments.what):
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
