"""The commands that judge controllers: score, compare."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.cli.reporting import say
from facts_damping.errors import InputError, RunError
from facts_damping.interruption import clean_up_first
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping_studies.pages import untuned_lines

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Mapping

    from facts_damping_studies.score.cases.sets import Controllers, Set
    from facts_damping_studies.score.score_card import ScoreCard


@contextmanager
def one_after_another() -> Iterator[Callable[[str, str], Progress]]:
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


def score(arguments: argparse.Namespace) -> None:
    """Score a controller on a set of cases, rank those of the set, or verify a card."""
    from facts_damping_studies.score import card, pages
    from facts_damping_studies.score.controllers import candidates
    from facts_damping_studies.score.worst import with_worst

    if arguments.verify is not None:
        _verify(arguments)
        return
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    clean_up_first()
    with one_after_another() as tell:
        case_set = _asked_set(arguments, folder, tell)
        against = None if arguments.against is None else arguments.against.split(",")
        controllers = candidates(case_set, arguments.controller, against)
        fresh = list(controllers) if arguments.controller is None else list(controllers)[:1]
        entries = card.entries_of(case_set, controllers, fresh, arguments.jobs, tell("score", "cases"))
        cards = card.cards_of(case_set, entries)
        cards = with_worst(case_set, cards, controllers, arguments.hunt, arguments.jobs, tell("hunt", "controllers"))
    if arguments.controller is not None:
        _tell_card(arguments, case_set, cards, controllers, folder)
        return
    ranked = card.ranking(cards)
    write_json(arguments.json, {"ranking": [each.document() for each in ranked]})
    say(arguments, *pages.ranking_table(ranked), *_untuned(case_set, controllers))
    if folder is not None:
        say(arguments, *(f"written: {path}" for path in pages.write_ranking(case_set, entries, ranked, folder)))


def _asked_set(arguments: argparse.Namespace, folder: Path | None, tell: Callable[[str, str], Progress]) -> Set:
    """The set by name or file, held out, or drawn for a grid of the user's own, which is written."""
    from facts_damping_studies.score.cases import own_grid, sets

    if arguments.system is None:
        case_set = sets.read_set(arguments.cases or sets.DEFAULT)
        if arguments.place is not None:
            raise InputError(f"--place {arguments.place}: given without --system; allowed: with it")
        if arguments.heldout is None:
            return case_set
        return sets.held_out(case_set, arguments.heldout, arguments.jobs, tell("score", "cases drawn"))
    for name in ("cases", "heldout"):
        if getattr(arguments, name) is not None:
            raise InputError(f"--{name} {getattr(arguments, name)}: given with --system; allowed: one of them")
    asked = own_grid.OwnGrid(arguments.system, own_grid.KINDS_OF_A_SET, own_grid.BESIDE, place=arguments.place)
    ground = own_grid.ground(asked, arguments.jobs, tell)
    say(arguments, *own_grid.ground_text(ground), f"digest of the set: {ground.case_set.digest}")
    if folder is not None:
        _write_set(arguments, ground.case_set, folder)
    return ground.case_set


def _write_set(arguments: argparse.Namespace, case_set: Set, folder: Path) -> None:
    write_whole(folder / "cases.yaml", dump(case_set.content.model_dump()))
    say(arguments, f"written: {folder / 'cases.yaml'}")


def _verify(arguments: argparse.Namespace) -> None:
    """Measure a card again; status 1 if anything is different."""
    from facts_damping_studies.score.verification import verified

    clean_up_first()
    with one_after_another() as tell:
        verification = verified(Path(arguments.verify), arguments.jobs, tell("verify", "cases"))
    write_json(arguments.json, verification._asdict())
    say(arguments, *verification.lines())
    if not verification.same:
        raise RunError(f"{arguments.verify}: the card does not hold")


def _tell_card(
    arguments: argparse.Namespace,
    case_set: Set,
    cards: list[ScoreCard],
    controllers: Mapping[str, Controllers],
    folder: Path | None,
) -> None:
    """The card of the first controller, beside the others."""
    from facts_damping_studies.score import card, pages

    name = next(iter(controllers))
    first = next(each for each in cards if each.controller == name)
    write_json(arguments.json, first.document())
    say(arguments, *pages.answer(first), "", *pages.kinds_table(first), "")
    say(arguments, *pages.ranking_table(card.ranking(cards)), *_untuned(case_set, controllers))
    if folder is not None:
        say(arguments, *(f"written: {path}" for path in pages.write(case_set, first, cards, folder)))


def _untuned(case_set: Set, controllers: Mapping[str, Controllers]) -> list[str]:
    """Lines about controllers that are not tuned for the system of a set."""
    from facts_damping_studies.score.cases.sets import case_of

    return [line for rows in controllers.values() for line in untuned_lines(case_of(case_set, rows, 0))]


def compare(arguments: argparse.Namespace) -> None:
    """Compare controllers on any grid, on cases that are drawn for it."""
    from facts_damping_studies.score import card, comparison, tuning
    from facts_damping_studies.score.cases import own_grid
    from facts_damping_studies.score.controllers import controllers_of

    names = ("place", "signal", "link", "profile", "seed")
    asked = own_grid.OwnGrid(arguments.system, comparison.kinds_of(arguments.seeds), sets=arguments.set)
    asked = asked._replace(**{name: getattr(arguments, name) for name in names})
    folder = None if arguments.out is None else files.new_folder(Path(arguments.out))
    texts = dict.fromkeys([arguments.controller, *arguments.against.split(",")])
    controllers = dict(controllers_of(text, "CONTROLLER, --against") for text in texts)
    clean_up_first()
    with one_after_another() as tell:
        ground = own_grid.ground(asked, arguments.jobs, tell)
        training = comparison.training_cases(ground, arguments.jobs, tell)
        entrants = tuning.tuned(ground, training, controllers, arguments.budget, arguments.jobs, tell)
        case_set = comparison.with_controllers(ground.case_set, entrants)
        entries = card.entries_of(case_set, entrants, list(entrants), arguments.jobs, tell("compare", "runs"))
        cards = card.cards_of(case_set, entries)
    say(arguments, *own_grid.ground_text(ground), *comparison.tuned_text(entrants, controllers), "")
    _tell_card(arguments, case_set, cards, entrants, folder)
    if folder is not None:
        _write_set(arguments, case_set, folder)
