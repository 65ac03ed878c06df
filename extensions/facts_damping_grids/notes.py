"""Notes of an import for the user: of elements that share a note, the first few are named, with their number."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.output.tables import some_of

if TYPE_CHECKING:
    from collections.abc import Iterable

NAMED = 3  # elements of a common note that are named


class Note(NamedTuple):
    """A note on one element: as it reads alone; and what it has in common with those of other elements, their kind."""

    alone: str
    common: str
    kind: str
    element: str


def told(notes: Iterable[str | Note]) -> list[str]:
    """The notes as lines, in the order of their first element."""
    groups: dict[object, list[str | Note]] = {}
    for note in notes:
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
