"""Tables as text."""

from __future__ import annotations

import itertools
import textwrap
from collections import Counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

WIDEST = 120  # characters of a line in a terminal
NARROWEST = 14  # of a column that is wrapped


def table(
    titles: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 1, *, markdown: bool = False, rule: bool = True
) -> list[str]:
    """Lines of a table for a terminal, or in Markdown; `rule`: a line below the titles, which are left out if empty.

    The first `left` columns are aligned to the left, the others to the right. On a terminal cells are wrapped, from the
    widest column on, until no line is longer than `WIDEST`.
    """
    cells = [list(titles), *([str(cell) for cell in row] for row in rows)]
    if markdown:
        kinds = ["---" if column < left else "--:" for column in range(len(titles))]
        return [f"| {' | '.join(row)} |" for row in (cells[0], kinds, *cells[1:])]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    while sum(widths) + 2 * (len(widths) - 1) > WIDEST and max(widths) > NARROWEST:
        widths[widths.index(max(widths))] -= 1
    rules = [["-" * width for width in widths]] if rule else []
    shown = [cells[0], *rules, *cells[1:]] if any(titles) else cells[1:]
    return [
        "  ".join(
            line.ljust(width) if column < left or line != cell else line.rjust(width)
            for column, (cell, line, width) in enumerate(zip(row, lines, widths, strict=True))
        ).rstrip()
        for row in shown
        for lines in itertools.zip_longest(*map(_wrapped, row, widths), fillvalue="")
    ]


def _wrapped(cell: str, width: int) -> list[str]:
    """The lines of a cell."""
    if len(cell) <= width:
        return [cell]
    return textwrap.wrap(cell, width, subsequent_indent="  ", break_on_hyphens=False)


def some_of(names: Sequence[str], maximum: int = 8) -> str:
    """Names separated by commas; of many, the first ones and the number of the others."""
    return ", ".join(names[:maximum]) + (f" and {len(names) - maximum} more" if len(names) > maximum else "")


def with_counts(lines: Iterable[str]) -> list[str]:
    """Each line once, with the number of equal ones."""
    return [line if count == 1 else f"{line} ({count} times)" for line, count in Counter(lines).items()]
