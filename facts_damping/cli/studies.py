"""The commands that make many runs: tune, search, sweep, reproduce and others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case import loading
from facts_damping.case.changes import read_profile
from facts_damping.cli.runs import page, say, summarise
from facts_damping.errors import InputError
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping.simulation import loop
from facts_damping.studies.sweeps.batch import make
from facts_damping.terminal import Progress, clean_up_first, write_json, write_whole

if TYPE_CHECKING:
    import argparse

    from facts_damping.studies.sweeps.sweep import Plan


def tune(arguments: argparse.Namespace) -> None:
    """Choose controllers' parameters on a system's training scenario, with the same search and budget for all."""
    from facts_damping.studies.search import tune as study

    files.check_writable(arguments.out, "--out")
    progress = Progress("tune", "controllers")
    try:
        devices = arguments.devices.split(",")
        signals = read_profile(arguments.profile).given(arguments.signals.split(","))
        asked = arguments.budget, arguments.seed, arguments.measurement, arguments.profile, arguments.scenario
        task = study.TuningTask(arguments.system, devices, signals, *asked)
        found = study.tune(task, arguments.controllers, arguments.jobs, progress)
    finally:
        progress.close()
    text = dump(study.document(found))
    if arguments.out is not None:
        write_whole(Path(arguments.out), text)
    write_json(arguments.json, found.model_dump())
    for row in found.controllers:
        say(arguments, f"{row.name:<10} {row.scheme or '':<9} objective {row.objective:g}")
    say(arguments, text if arguments.out is None else f"parameters: {arguments.out}")


def design(arguments: argparse.Namespace) -> None:
    """Rank places of devices and signals by residue, and design a lead-lag controller for a mode."""
    from facts_damping.studies.design import design as study
    from facts_damping.studies.design import design_pages as pages

    task = study.Task(
        arguments.system,
        arguments.set,
        arguments.damping,
        arguments.delay,
        arguments.mode,
        arguments.place,
        arguments.signal,
    )
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    given = Path(arguments.system)
    if folder is not None and given.exists() and given.resolve() == (folder / "system.yaml").resolve():
        raise InputError(f"--out {arguments.out}: given, where SYSTEM would be replaced; allowed: another folder")
    shown: list[Progress] = []

    def tell(name: str, what: str) -> Progress:
        for before in shown:
            before.close()
        shown[:] = [Progress(name, what)]
        return shown[0]

    try:
        found = study.design(task, arguments.jobs, tell)
    finally:
        for progress in shown:
            progress.close()
    written = []
    if folder is not None:
        written = [*pages.write(found, folder), pages.draw(found, folder / "places.png")]
        write_json(str(folder / "result.json"), pages.document(found))
    write_json(arguments.json, pages.document(found))
    for line in (*pages.text(found), *(f"written: {path}" for path in written)):
        say(arguments, line)


def search(arguments: argparse.Namespace) -> None:
    """Choose a controller and its parameters on training cases: all pairs, schemes, devices, compensations."""
    from facts_damping.studies.search import search as study
    from facts_damping.studies.search import search_pages as pages
    from facts_damping.studies.search.tune import document

    files.check_writable(arguments.out, "--out")
    files.check_writable(arguments.lead_lag, "--lead-lag")
    files.check_writable(arguments.tuned, "--tuned")
    if arguments.tuned is not None and arguments.devices is None:
        raise InputError(
            f"--tuned {arguments.tuned}: given without --devices; allowed: with it, as a file is of one set"
        )
    devices = tuple(arguments.devices.split(",")) if arguments.devices else ()
    asked = {name: value for name, value in vars(arguments).items() if name in study.SearchTask._fields}
    signals = tuple(arguments.signals.split(",")) if arguments.signals else ()
    task = study.SearchTask(**{**asked, "devices": devices, "signals": signals})
    progress = Progress("search", "structures")
    try:
        found = study.search(task, arguments.controllers, arguments.jobs, progress)
    finally:
        progress.close()
    command = task.command(arguments.controllers)
    opponent = next(entry for entry in found if entry.structure.is_reference)
    best = next((entry for entry in found if not entry.structure.is_reference), opponent)
    run = pages.run_file(task, command, best)
    if arguments.out is not None:
        write_whole(Path(arguments.out), run)
    if arguments.lead_lag is not None:
        write_whole(Path(arguments.lead_lag), pages.run_file(task, command, opponent))
    if arguments.tuned is not None:
        write_whole(Path(arguments.tuned), dump(document(pages.tuned(task, command, found))))
    write_json(arguments.json, {"command": command, "ranking": pages.rows(found)})
    for line in pages.search_table(found):
        say(arguments, line)
    say(arguments, run if arguments.out is None else f"run: {arguments.out}")


def sweep(arguments: argparse.Namespace) -> None:
    """Run a study in parallel: table, delay margins, pictures; continues after an interruption."""
    from facts_damping.studies.sweeps import point_figures, results, sweep_plots, tables
    from facts_damping.studies.sweeps import sweep as study

    sets = [*([f"profile={arguments.profile}"] if arguments.profile else []), *arguments.set]
    plan = study.plan(arguments.study, sets, arguments.only, check_step=arguments.check_step)
    folder = Path(arguments.out) if arguments.out is not None else Path("results") / plan.name
    _check_report(arguments.report, plan, folder)
    progress = Progress(plan.name, "runs")
    clean_up_first()
    try:
        found = study.run(plan, folder, arguments.jobs, arguments.scheduler, progress)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"the same command goes on where it stopped: {folder}") from None
    finally:
        progress.close()
    rows, margins = study.rows(found), study.found_margins(plan, found)
    fractions, across = study.found_fractions(plan, found), study.across(plan)
    asked = plan.study.tables
    figures = tables.figure_tables(rows, asked) if asked else []
    write_json(arguments.json, {"rows": rows, "margins": margins, "fractions": fractions})
    for line in (*results.sweep_tables(rows, margins, fractions, across), "", *figures):
        say(arguments, line)
    if asked:
        write_whole(folder / "tables.md", "\n".join([f"# {plan.name}", "", plan.study.description, "", *figures]))
        say(arguments, f"tables: {folder / 'tables.md'}")
    for path in results.write(folder, rows, margins, fractions):
        say(arguments, f"table: {path}")
    pictures = tables.draw(rows, asked, folder) if asked else []
    pictures += sweep_plots.draw(rows, study.swept(plan), margins, across, folder)
    for path in (*pictures, *point_figures.draw(plan, folder, arguments.jobs)):
        say(arguments, f"picture: {path}")
    _report(arguments, plan)


def _check_report(path: str | None, plan: Plan, folder: Path) -> None:
    """Raise `InputError` if a study's runs do not fit on one page, or the page cannot be written."""
    from facts_damping.analysis.plotting.plots import COLOURS

    if path is None:
        return
    if plan.study.margin is not None:
        raise InputError("--report: given with a study that searches margins; allowed: with other studies")
    if len(plan.points) > len(COLOURS):
        allowed = f"1 to {len(COLOURS)}, chosen by --only COLUMN=VALUE,..."
        raise InputError(f"--report: given with {len(plan.points)} runs; allowed: {allowed}")
    files.new_folder(folder)  # the page may be one of its files
    files.check_writable(path, "--report", standard=False)


def _report(arguments: argparse.Namespace, plan: Plan) -> None:
    """Write one page that compares the runs of a study, each named by what differs; the runs are made again."""
    if arguments.report is None:
        return
    from facts_damping.analysis import details

    named, columns = [], plan.points[0].columns
    differing = [name for name in columns if len({str(point.columns[name]) for point in plan.points}) > 1]
    for point in plan.points:
        told = ", ".join(str(point.columns[name]) for name in differing)
        named.append((told or plan.name, loop.run(make(plan.base, point.changes))))
    results = [summarise(record, None, None) | details.details(record) for _, record in named]
    details.compare(results, 0)
    for line in page(arguments, named, results, 0):
        say(arguments, line)


def margin(arguments: argparse.Namespace) -> None:
    """The delay margin of a loop with linear controllers, and its modes over the delay."""
    from facts_damping.studies.margins import linear_margin as study
    from facts_damping.studies.margins import linear_margin_pages as pages
    from facts_damping.studies.margins.linear_margin_runs import beside

    case, runs = loading.load_case(arguments.run, arguments.set), None
    progress = Progress("margin", "delays")
    try:
        found = study.margin(case, arguments.max_delay, arguments.pade, progress)
    finally:
        progress.close()
    if arguments.time_domain:
        progress = Progress("margin", "runs")
        try:
            runs = beside(found, progress)
        finally:
            progress.close()
    pictures = []
    if arguments.out is not None:
        folder = files.new_folder(Path(arguments.out))
        pictures += [pages.draw(found, runs, folder / "margin.png"), pages.draw_loops(found, folder / "one_line.png")]
    write_json(arguments.json, pages.document(found, runs))
    for line in (*pages.margin_text(found, runs), *(f"plot: {path}" for path in pictures)):
        say(arguments, line)
