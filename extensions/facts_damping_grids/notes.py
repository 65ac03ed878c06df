"""Notes of an import for the user: of elements that share a note, the first few are named, with their number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

from facts_damping.output.tables import some_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    Outcome = Literal["", "replaced", "left out", "idle"]

NAMED = 3  # elements of a common note that are named


class Note(NamedTuple):
    """A note on one element: as it reads alone; and what it has in common with those of other elements, their kind.

    `record`: section of the RAW file or model of the DYR file; with an outcome it is replaced, left out, or idle as in
    PSS/E, and the report counts it; `effect`: what that can change.
    """

    alone: str
    common: str
    kind: str
    element: str
    record: str = ""
    outcome: Outcome = ""
    effect: str = ""


def note_lines(notes: Iterable[str | Note]) -> list[str]:
    """The notes as lines, in the order of their first element; what is idle in PSS/E, too, is left to the report."""
    groups: dict[object, list[str | Note]] = {}
    for note in notes:
        if isinstance(note, Note) and note.outcome == "idle":
            continue
        groups.setdefault(note if isinstance(note, str) else (note.common, note.kind), []).append(note)
    lines = []
    for first, *others in groups.values():
        if isinstance(first, str):
            lines.append(first)
        elif not others:
            lines.append(first.alone)
        else:
            names = [note.element for note in (first, *others) if isinstance(note, Note)]
            lines.append(f"{first.common} ({len(names)} {first.kind}: {some_of(names, NAMED)})")
    return lines
