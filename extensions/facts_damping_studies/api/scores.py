"""Scores of controllers on frozen sets of cases."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from facts_damping.api.cases import plain, short_traceback
from facts_damping.output.terminal import Progress
from facts_damping.parameters.files import new_folder
from facts_damping_studies.score import card as cards
from facts_damping_studies.score import pages
from facts_damping_studies.score.cases import sets
from facts_damping_studies.score.controllers import candidates
from facts_damping_studies.score.worst import with_worst
from facts_damping_studies.sweeps.pool import refuse_within

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from facts_damping_studies.score.cases.sets import Set
    from facts_damping_studies.score.score_card import ScoreCard


@dataclass(frozen=True, repr=False)
class Score:
    """A controller's card (docs/score.md), and those of the controllers beside it."""

    _card: ScoreCard = field(repr=False)
    _beside: list[ScoreCard] = field(repr=False)
    _set: Set = field(repr=False)

    @cached_property
    def content(self) -> dict[str, Any]:
        """The card as in its JSON."""
        return self._card.document()

    @cached_property
    def beside(self) -> list[dict[str, Any]]:
        """The cards of the controllers beside it."""
        return [card.document() for card in self._beside]

    @property
    def value(self) -> float:
        """The score: 0 for no control, 100 for the upper reference."""
        return self._card.score.value

    def save(self, folder: str | PathLike[str]) -> list[Path]:
        """Write the card as page, JSON and picture; return the paths."""
        return pages.write(self._set, self._card, [self._card, *self._beside], new_folder(Path(folder)))

    def __repr__(self) -> str:
        """What came out, in a few lines."""
        return "\n".join([*pages.answer(self._card), "", *pages.kinds_table(self._card)])


@short_traceback
def score(
    controller: Any,
    cases: str = sets.DEFAULT,
    against: Sequence[str] | None = None,
    *,
    hunt: int = 0,
    heldout: str | None = None,
    jobs: int | None = None,
    progress: bool = False,
) -> Score:
    """Score a controller on a frozen set of cases, beside no control and others.

    `controller`: a name, `file.py:Class`, `module:Class`, a run, an FMU or a linear law as text; a class; a row of
    `controllers` of a run, or a list of them. `cases`: name or path of a set; `against`: others beside it, the set's by
    default; `hunt`: also search for the worst of so many cases in which something fails; `heldout`: the text that the
    held-out cases of the set are drawn from; `jobs`: runs at once, all
    cores by default. Raises `InputError`.
    """
    refuse_within()
    jobs = jobs or os.cpu_count() or 1
    case_set = sets.read_set(cases)
    if heldout is not None:
        with Progress("score", "cases drawn", shown=progress) as shown:
            case_set = sets.held_out(case_set, heldout, jobs, shown)
    entrants = candidates(case_set, plain(controller), against)
    name = next(iter(entrants))
    with Progress("score", "cases", shown=progress) as shown:
        entries = cards.entries_of(case_set, entrants, [name], jobs, shown)
    measured_cards = sorted(cards.cards_of(case_set, entries), key=lambda card: card.controller != name)
    with Progress("hunt", "controllers", shown=progress) as shown:
        hunted_cards = with_worst(case_set, measured_cards, entrants, hunt, jobs, shown)
    return Score(hunted_cards[0], hunted_cards[1:], case_set)
