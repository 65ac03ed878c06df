"""Rows of a hunt: its cases, and the mildest forms of the worst."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from facts_damping_studies.campaigns.campaign import Choice
from facts_damping_studies.campaigns.draw_rows import NOTHING_DRAWN, DrawnFault
from facts_damping_studies.rows import WHOLE, Row

if TYPE_CHECKING:
    from collections.abc import Mapping

Arm = Literal["hunted", "random"]
HUNTED: Arm = "hunted"
RANDOM: Arm = "random"
SHRUNK: Literal["shrunk"] = "shrunk"


@dataclass(frozen=True)
class HuntRow(Row):
    """A case of a hunt, hunted or random."""

    arm: Arm
    number: int
    numbers: list[float]  # its point of the unit cube
    error: str | None  # why it failed
    margins: dict[str, float | None] = field(metadata=WHOLE)  # by rule; None: nothing can violate it
    content: str  # what distinguishes it (`hunt.content`)
    drawn: DrawnFault = NOTHING_DRAWN  # with the label of the controller
    took_s: float = field(kw_only=True)  # time of computing
    at_s: float | None = None  # time from the beginning of the hunt to its end


@dataclass(frozen=True)
class ShrunkRow(Row):
    """The mildest form of a case that violates a rule."""

    arm: Literal["shrunk"]
    number: int  # of the case
    choice: dict[str, Any] = field(metadata=WHOLE)  # of `campaign.Choice`
    sizes: list[float]  # numbers from 0 to 1 for the size of the fault
    margin: float
    cases: int  # that were run for it

    @property
    def chosen(self) -> Choice:
        """What it is."""
        return Choice(**self.choice)


def read_hunt(cells: Mapping[str, Any]) -> HuntRow | ShrunkRow:
    """The row of a hunt's journal."""
    return (ShrunkRow if cells["arm"] == SHRUNK else HuntRow).read(cells)
