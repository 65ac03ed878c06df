"""The commands that choose controllers: tune, design, search."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case.changes import read_profile
from facts_damping.cli.reporting import say
from facts_damping.errors import InputError, check_known
from facts_damping.interruption import clean_up_first
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping_studies.score_commands import one_after_another

if TYPE_CHECKING:
    import argparse

    from facts_damping_studies.design.design import Task

BEST, RESIDUE = "best", "residue"  # values of `design --law` that name no law


def tune(arguments: argparse.Namespace) -> None:
    """Choose controllers' parameters on a system's training scenario, with the same search and budget for all."""
    from facts_damping_studies.search import tune as study

    files.check_writable(arguments.out, "--out")
    devices = arguments.devices.split(",")
    signals = read_profile(arguments.profile).given(arguments.signals.split(","))
    asked = arguments.budget, arguments.seed, arguments.measurement, arguments.profile, arguments.scenario
    task = study.TuningTask(arguments.system, devices, signals, *asked)
    with Progress("tune", "runs") as progress:
        tuned = study.tune(task, arguments.controllers, arguments.jobs, progress)
    text = dump(study.document(tuned))
    if arguments.out is not None:
        write_whole(Path(arguments.out), text)
    write_json(arguments.json, tuned.model_dump())
    for row in tuned.controllers:
        say(arguments, f"{row.name:<10} {row.scheme or '':<9} objective {row.objective:g}")
    say(arguments, text if arguments.out is None else f"parameters: {arguments.out}")
    say(arguments, "" if arguments.out is None else f"runs with them: --set tuning={arguments.out}")


def design(arguments: argparse.Namespace) -> None:
    """Design a law that holds in all scenarios of a grid, or a lead-lag by the residue of one mode."""
    from facts_damping_studies.design import design as study

    names = ("system", "set", "damping", "delay", "mode", "place", "signal")
    task = study.Task(*(getattr(arguments, name) for name in names))
    delay = study.DELAY_S if arguments.delay is None else arguments.delay
    task = task._replace(kinds=arguments.kinds.split(","), profile=arguments.profile, delay=delay)
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    system_path = Path(arguments.system)
    if folder is not None and system_path.exists() and system_path.resolve() == (folder / "system.yaml").resolve():
        raise InputError(f"--out {arguments.out}: given, would overwrite SYSTEM; allowed: another folder")
    clean_up_first()
    if arguments.law == RESIDUE:
        _residue_design(arguments, task, folder)
    else:
        _robust_design(arguments, task, folder)


def _residue_design(arguments: argparse.Namespace, task: Task, folder: Path | None) -> None:
    from facts_damping_studies.design import design as study
    from facts_damping_studies.design import design_pages as pages

    with one_after_another() as tell:
        ranking = study.ranked(task, arguments.jobs, tell)
        say(arguments, *pages.ranking_text(ranking))
        completed = study.completed(ranking, tell)
    written = []
    if folder is not None:
        written = [*pages.write(completed, folder), pages.plot(completed, folder / "places.png")]
        write_json(str(folder / "result.json"), pages.document(completed))
    write_json(arguments.json, pages.document(completed))
    say(arguments, *pages.design_text(completed), *(f"written: {path}" for path in written))


def _robust_design(arguments: argparse.Namespace, task: Task, folder: Path | None) -> None:
    from facts_damping_studies.design.design_pages import ranking_text
    from facts_damping_studies.robust import robust_design as study
    from facts_damping_studies.robust import robust_pages as pages
    from facts_damping_studies.robust.grid_run import grid_run
    from facts_damping_studies.robust.laws import LAWS

    laws = list(LAWS) if arguments.law == BEST else arguments.law.split(",")
    for law in laws:
        check_known("--law", law, [BEST, *LAWS, RESIDUE])
    with one_after_another() as tell:
        run = grid_run(task, arguments.delay, arguments.jobs, tell)
        if run.ranking is not None:
            say(arguments, *ranking_text(run.ranking))
        further = arguments.further_delay, arguments.outages
        specification = study.RobustTask(run.case(), run.signals, *further, laws, arguments.jobs)
        completed = study.designed(specification, tell)
    written = []
    if folder is not None:
        written = [*pages.write(completed, task, run, folder), pages.plot(completed, folder / "damping.png")]
        write_json(str(folder / "result.json"), pages.document(completed))
    write_json(arguments.json, pages.document(completed))
    say(arguments, *pages.text(completed), *(f"written: {path}" for path in written))


def search(arguments: argparse.Namespace) -> None:
    """Choose a controller and its parameters on training cases: all pairs, schemes, devices, compensations."""
    from facts_damping_studies.search import search as study
    from facts_damping_studies.search import search_pages as pages
    from facts_damping_studies.search.tune import document

    files.check_writable(arguments.out, "--out")
    files.check_writable(arguments.lead_lag, "--lead-lag")
    files.check_writable(arguments.tuned, "--tuned")
    if arguments.tuned is not None and arguments.devices is None:
        allowed = "with --devices: a file is for one set of them"
        raise InputError(f"--tuned {arguments.tuned}: given without --devices; allowed: {allowed}")
    devices = tuple(arguments.devices.split(",")) if arguments.devices else ()
    asked = {name: value for name, value in vars(arguments).items() if name in study.SearchTask._fields}
    signals = tuple(arguments.signals.split(",")) if arguments.signals else ()
    task = study.SearchTask(**{**asked, "devices": devices, "signals": signals})
    with Progress("search", "structures") as progress:
        entries = study.search(task, arguments.controllers, arguments.jobs, progress)
    command = task.command(arguments.controllers)
    opponent = next(entry for entry in entries if entry.structure.is_reference)
    best = next((entry for entry in entries if not entry.structure.is_reference), opponent)
    run = pages.run_file(task, command, best)
    if arguments.out is not None:
        write_whole(Path(arguments.out), run)
    if arguments.lead_lag is not None:
        write_whole(Path(arguments.lead_lag), pages.run_file(task, command, opponent))
    if arguments.tuned is not None:
        write_whole(Path(arguments.tuned), dump(document(pages.tuned(task, command, entries))))
    write_json(arguments.json, {"command": command, "ranking": pages.rows(entries)})
    say(arguments, *pages.search_table(entries), run if arguments.out is None else f"run: {arguments.out}")
