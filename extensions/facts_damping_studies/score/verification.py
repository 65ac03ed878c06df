"""A card is verified: its controller is measured again, from the card alone, and compared case by case."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError
from facts_damping_studies.score.card import cards_of
from facts_damping_studies.score.cases.sets import read_set, set_of
from facts_damping_studies.score.entries import FIXED, entry_of, measured_entries, read_card
from facts_damping_studies.score.files import unpacked
from facts_damping_studies.score.pages import score_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping_studies.score.cases.sets import Set
    from facts_damping_studies.score.measure import Measured

MOST = 5  # differences that are listed
OF_MACHINE = ("computing",)  # what another machine or moment changes


class Verification(NamedTuple):
    """What came out: the controller, number of cases, differences, and the score of the card and measured again."""

    controller: str
    set: str
    cases: int
    differences: list[str]
    stored: str
    measured: str

    @property
    def same(self) -> bool:
        """Whether the card holds."""
        return not self.differences and self.stored == self.measured

    def lines(self) -> list[str]:
        """It in a few sentences."""
        counts = f"{len(self.differences)} differences in {self.cases} cases" if self.differences else "all the same"
        return [
            f"{self.controller}: {self.cases} cases of {self.set} measured again: {counts}",
            *self.differences[:MOST],
            f"score on the card {self.stored}, measured again {self.measured}",
        ]


def verified(path: Path, jobs: int, progress: Callable[[int, int], None]) -> Verification:
    """Measure the controller of a card, no control and the references again. Raises `InputError`."""
    content = read_card(path)
    stored = entry_of(content, str(path))
    if "score" not in content:
        raise InputError(f"{path}: an entry without a score given; allowed: the card of a controller")
    case_set = _set_of(content, path)
    with TemporaryDirectory(prefix="facts_damping_card_") as folder:
        rows = unpacked(stored.rows, stored.files, Path(folder))
        entries = measured_entries(case_set, {**dict.fromkeys(FIXED, ()), stored.name: rows}, jobs, progress)
    again = entries[stored.name]
    differences = [
        f"case {i}, {case.kind}: {difference}"
        for i, case in enumerate(case_set.cases)
        for difference in _differences(stored.cases[i], again.cases[i])
    ]
    card = next(card for card in cards_of(case_set, entries) if card.controller == stored.name)
    score = type(card.score)(**content["score"])
    return Verification(
        stored.name, case_set.name, len(case_set.cases), differences, score_text(score), score_text(card.score)
    )


def _set_of(content: dict[str, object], path: Path) -> Set:
    """The set of a card: a shipped one, or that which the card holds."""
    if "case_set" in content:
        table = content["case_set"]
        if not isinstance(table, dict):
            raise InputError(f"{path}: case_set: {type(table).__name__} given; allowed: the content of a set")
        case_set = set_of(str(content["set"]).rpartition(" ")[0], table, str(path))
    else:
        case_set = read_set(str(content["set"]).replace(" ", "_"))
    if case_set.digest != content["set_digest"]:
        allowed = f"{case_set.digest}, that of the set as this version draws it"
        raise InputError(f"{path}: set_digest: {content['set_digest']} given; allowed: {allowed}")
    return case_set


def _differences(stored: Measured, again: Measured) -> list[str]:
    return [
        f"{name}: {before} on the card, {after} measured again"
        for name, before, after in zip(stored._fields, stored, again, strict=True)
        if before != after and name not in OF_MACHINE
    ]
