"""The commands `analyze`, figures, pictures and a page of recordings, and `locate`, where an oscillation comes from."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case import loading
from facts_damping.cli.reporting import report, run_result, say
from facts_damping.errors import InputError, RecordingError, check_known, one_line
from facts_damping.findings import names, without_control
from facts_damping.output.terminal import Progress, note, put
from facts_damping.output.writing import write_json
from facts_damping.parameters import files
from facts_damping.record import Record
from facts_damping.recording.bagfile import FILE_NAME
from facts_damping.recording.reader import load
from facts_damping.simulation.replaying.replay import check_has_run
from facts_damping_views.analysis import details, locating

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from facts_damping.analysis.summary import Summary

LIVE_S = 60.0  # s, the newest time that `locate --every` uses
FREE = "no_control"  # stands for a recording: the same run without control


def analyze(arguments: argparse.Namespace) -> None:
    """Print figures and make plots of recordings."""
    files.check_writable(arguments.report, "--report", standard=False)
    if arguments.spwvd is None and (arguments.windows or arguments.band):
        raise InputError("--windows, --band: given without --spwvd; allowed: with --spwvd SIGNAL,...")
    paths = list(arguments.recordings)
    first = paths[0] if arguments.baseline is None else arguments.baseline
    check_known("--baseline", first, [*paths, FREE])
    records = list[Record]()
    with Progress("read", "recordings") as progress:
        for i, path in enumerate(paths):
            progress(i, len(paths))
            records.append(_explained(load(path), path, arguments.run))
    if first == FREE:
        paths.append(FREE)
        records.append(without_control(records[0]))
    labels, baseline = names(records), paths.index(first)
    results = [
        run_result(record, recording=str(path), method=arguments.modes_method)
        for record, path in zip(records, paths, strict=True)
    ]
    summaries = [result.summary for result in results]
    percents = details.improvements(summaries, baseline)
    rows = [
        details.details(record)._replace(improvement_percent=percent)
        for record, percent in zip(records, percents, strict=True)
    ]
    results = [replace(result, more=row._asdict()) for result, row in zip(results, rows, strict=True)]
    named = list(zip(labels, records, strict=True))
    folder = Path(arguments.out) if arguments.out is not None else Path(paths[0]).parent / "analysis"
    more = [*details.lines(labels, summaries, rows, baseline), *_distributions(arguments, named, summaries, folder)]
    if arguments.report is not None:
        from facts_damping_views.report import ReportedRun, write_runs

        runs = map(ReportedRun, labels, records, summaries, map(str, paths), percents)
        write_runs(Path(arguments.report), list(runs), baseline)
        more.append(f"report: {arguments.report}")
    report(arguments, named, results, files.new_folder(folder), *more)


def locate(arguments: argparse.Namespace) -> None:
    """Tell where the oscillation of a recording comes from, and draw it; again and again while it is being made."""
    path = Path(arguments.recording)
    marker = path / FILE_NAME
    if arguments.every is None:
        with Progress("locate", "steps: read, locate and draw") as progress:
            progress(0, 2)
            record = _explained(load(path), arguments.recording, arguments.run)
            progress(1, 2)
            _located(arguments, record, arguments.since, drawn=True)
        return
    if not path.is_dir():
        raise InputError(f"--every: given with {path}; allowed: with the folder of a recording")
    ended = False
    while not ended:
        ended = marker.exists()  # before it is read: then all of it is there
        try:
            record = _explained(load(path), arguments.recording, arguments.run)
            newest = max(float(record.time_s[-1]) - LIVE_S, locating.last_event(record))
            _located(arguments, record, newest if arguments.since is None else arguments.since, drawn=ended)
        except (InputError, RecordingError) as error:
            if ended:
                raise
            note(f"not yet: {one_line(error)}")
        if not ended:
            put("\n", flush=True)
            time.sleep(arguments.every)


def _located(arguments: argparse.Namespace, record: Record, since: float | None, *, drawn: bool) -> None:
    """Locate once; tell it, and write the picture if it is to be `drawn`."""
    system = loading.recorded_case(record.configuration, arguments.recording).system
    try:
        where = locating.locate(record, system, arguments.frequency, since, arguments.until)
    except InputError as error:
        raise InputError(f"{arguments.recording}: {error}") from error
    written = []
    if drawn:
        from facts_damping_views.analysis import energy_picture

        folder = Path(arguments.out) if arguments.out is not None else Path(arguments.recording).parent / "analysis"
        written.append(f"plot: {energy_picture.plot(system, where, files.new_folder(folder) / 'energy_flow.png')}")
    write_json(arguments.json, where)
    for line in record.notes if drawn else []:
        note(f"{arguments.recording}: {line}")
    say(arguments, *locating.lines(where), *written)


def _distributions(
    arguments: argparse.Namespace, named: Sequence[tuple[str, Record]], summaries: Sequence[Summary], folder: Path
) -> list[str]:
    """Draw time-frequency pictures if asked for; one line each."""
    if arguments.spwvd is None:
        return []
    from facts_damping_views.analysis.time_frequency_plots import Settings, distribution_figures, save

    asked = Settings()
    if arguments.windows:
        asked = asked._replace(lag=arguments.windows[0], time=arguments.windows[1])
    if arguments.band:
        asked = asked._replace(band=arguments.band)
    records = [
        (name, record, [mode.frequency_hz for mode in summary.modes])
        for (name, record), summary in zip(named, summaries, strict=True)
    ]
    figures, notes = distribution_figures(records, arguments.spwvd.split(","), asked)
    paths = save(figures, files.new_folder(folder))
    for line in notes:
        note(line)
    return [f"plot: {path}" for path in paths]


def _explained(record: Record, path: str, run_name: str | None) -> Record:
    """The record; if it holds no run (`ros2 bag record` stores none), with the run of a name or file."""
    if record.configuration or run_name is None:
        check_has_run(record, path)
        return record
    return replace(record, configuration=loading.load_case(run_name).document())
