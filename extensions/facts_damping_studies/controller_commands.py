"""The commands that choose or judge controllers: tune, design, search, score, compare."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.case.changes import read_profile
from facts_damping.cli.reporting import say
from facts_damping.errors import InputError
from facts_damping.interruption import clean_up_first
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping_studies.pages import untuned_lines

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from facts_damping_studies.score.card import Controllers, Set
    from facts_damping_studies.score.score_card import ScoreCard


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
    """Rank places of devices and signals by residue, and design a lead-lag controller for a mode."""
    from facts_damping_studies.design import design as study
    from facts_damping_studies.design import design_pages as pages

    names = ("system", "set", "damping", "delay", "mode", "place", "signal")
    task = study.Task(*(getattr(arguments, name) for name in names))
    task = task._replace(kinds=arguments.kinds.split(","), profile=arguments.profile)
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    system_path = Path(arguments.system)
    if folder is not None and system_path.exists() and system_path.resolve() == (folder / "system.yaml").resolve():
        raise InputError(f"--out {arguments.out}: given, would overwrite SYSTEM; allowed: another folder")
    clean_up_first()
    with _one_after_another() as tell:
        ranking = study.ranked(task, arguments.jobs, tell)
        say(arguments, *pages.ranking_text(ranking))
        completed = study.completed(ranking, tell)
    written = []
    if folder is not None:
        written = [*pages.write(completed, folder), pages.plot(completed, folder / "places.png")]
        write_json(str(folder / "result.json"), pages.document(completed))
    write_json(arguments.json, pages.document(completed))
    say(arguments, *pages.design_text(completed), *(f"written: {path}" for path in written))


@contextmanager
def _one_after_another() -> Iterator[Callable[[str, str], Progress]]:
    """Progress of several steps of a command, each on a line of its own."""
    shown: list[Progress] = []

    def tell(name: str, what: str) -> Progress:
        for before in shown:
            before.close()
        shown[:] = [Progress(name, what)]
        return shown[0]

    try:
        yield tell
    finally:
        for progress in shown:
            progress.close()


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


def score(arguments: argparse.Namespace) -> None:
    """Score a controller on a frozen set of cases, or rank the shipped ones."""
    from facts_damping_studies.score import card, pages
    from facts_damping_studies.score.controllers import candidates
    from facts_damping_studies.score.worst import with_worst

    case_set = card.read_set(arguments.cases)
    against = None if arguments.against is None else arguments.against.split(",")
    entrants = candidates(case_set, arguments.controller, against)
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    clean_up_first()
    with Progress("score", "cases") as progress:
        cards = card.cards_of(case_set, entrants, arguments.jobs, progress)
    with Progress("hunt", "controllers") as progress:
        cards = with_worst(case_set, cards, entrants, arguments.hunt, arguments.jobs, progress)
    ranked = card.ranking(cards)
    if arguments.controller is not None:
        _tell_card(arguments, case_set, cards, entrants, folder)
        return
    write_json(arguments.json, {"ranking": [each.document() for each in ranked]})
    say(arguments, *pages.ranking_table(ranked), *_untuned(case_set, entrants))
    if folder is not None:
        say(arguments, *(f"written: {path}" for path in pages.write_ranking(ranked, folder)))


def _tell_card(
    arguments: argparse.Namespace,
    case_set: Set,
    cards: Sequence[ScoreCard],
    entrants: Mapping[str, Controllers],
    folder: Path | None,
) -> None:
    """The first card, beside the others."""
    from facts_damping_studies.score import card, pages

    write_json(arguments.json, cards[0].document())
    say(arguments, *pages.answer(cards[0]), "", *pages.kinds_table(cards[0]), "")
    say(arguments, *pages.ranking_table(card.ranking(cards)), *_untuned(case_set, entrants))
    if folder is not None:
        say(arguments, *(f"written: {path}" for path in pages.write(case_set, cards, folder)))


def _untuned(case_set: Set, entrants: Mapping[str, Controllers]) -> list[str]:
    """Lines about controllers that are not tuned for the system of a set."""
    from facts_damping_studies.score import card

    return [line for rows in entrants.values() for line in untuned_lines(card.case_of(case_set, rows, 0))]


def compare(arguments: argparse.Namespace) -> None:
    """Compare controllers on any grid, on cases that are drawn for it."""
    from facts_damping_studies.score import card, comparison, tuning
    from facts_damping_studies.score.controllers import controllers_of

    names = ("system", "set", "place", "signal", "link", "profile", "seeds", "seed")
    asked = comparison.Comparison(*(getattr(arguments, name) for name in names))
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    texts = dict.fromkeys([arguments.controller, *arguments.against.split(",")])
    controllers = dict(controllers_of(text, "CONTROLLER, --against") for text in texts)
    clean_up_first()
    with _one_after_another() as tell:
        ground = comparison.ground(asked, arguments.jobs, tell)
        entrants = tuning.tuned(ground, controllers, arguments.budget, arguments.jobs, tell)
        case_set = comparison.case_set_of(ground, entrants)
        cards = card.cards_of(case_set, entrants, arguments.jobs, tell("compare", "runs"))
    say(arguments, *comparison.ground_text(ground, entrants, controllers), "")
    _tell_card(arguments, case_set, cards, entrants, folder)
    if folder is not None:
        write_whole(folder / "cases.yaml", dump(case_set.content.model_dump()))
        say(arguments, f"written: {folder / 'cases.yaml'}")
