"""Tables as text."""

from __future__ import annotations

from collections import Counter
from itertools import zip_longest
from textwrap import wrap
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

WIDTH, NARROW = 120, 12  # characters: cells of a table wider than a terminal are wrapped, down to the latter


def table(
    titles: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 1, *, markdown: bool = False, rule: bool = True
) -> list[str]:
    """Lines of a table for a terminal, or in Markdown; `rule`: a line below the titles.

    The first `left` columns are aligned to the left, the others to the right; a wide table is wrapped on a terminal.
    """
    cells = [list(titles), *([str(cell) for cell in row] for row in rows)]
    if markdown:
        kinds = ["---" if column < left else "--:" for column in range(len(titles))]
        return [f"| {' | '.join(row)} |" for row in (cells[0], kinds, *cells[1:])]
    head, *lines = _wrapped(cells, left)
    widths = [max(map(len, column)) for column in zip(*head, *(line for row in lines for line in row), strict=True)]
    rules = [["-" * width for width in widths]] if rule else []
    return [
        "  ".join(
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (*head, *rules, *(line for row in lines for line in row))
    ]


def _wrapped(cells: Sequence[Sequence[str]], left: int) -> list[list[tuple[str, ...]]]:
    """The lines of each row; cells of other than the first `left` columns are as wide as `WIDTH` allows."""
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    room = WIDTH - sum(widths[:left]) - 2 * (len(widths) - 1)
    fitting = (wide for wide in range(WIDTH, NARROW, -1) if sum(min(wide, width) for width in widths[left:]) <= room)
    widest = next(fitting, max(widths))
    lines = ((wrap(cell, widest) if widest < len(cell) else [cell] for cell in row[left:]) for row in cells)
    first = ([[cell] for cell in row[:left]] for row in cells)
    return [list(zip_longest(*names, *parts, fillvalue="")) for names, parts in zip(first, lines, strict=True)]


def some_of(names: Sequence[str], maximum: int = 8) -> str:
    """Names separated by commas; of many, the first ones and the number of the others."""
    return ", ".join(names[:maximum]) + (f" and {len(names) - maximum} more" if len(names) > maximum else "")


def counted(lines: Iterable[str]) -> list[str]:
    """Each line once, with the number of equal ones."""
    return [line if count == 1 else f"{line} ({count} times)" for line, count in Counter(lines).items()]
