"""Tables as text."""

from __future__ import annotations

import csv
import io
import itertools
from collections import Counter
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


def table(
    titles: Sequence[str], rows: Iterable[Sequence[Any]], left: int = 1, *, markdown: bool = False, rule: bool = True
) -> list[str]:
    """Lines of a table for a terminal, or in Markdown; `rule`: a line below the titles.

    The first `left` columns are aligned to the left, the others to the right.
    """
    cells = [list(titles), *([str(cell) for cell in row] for row in rows)]
    if markdown:
        kinds = ["---" if column < left else "--:" for column in range(len(titles))]
        return [f"| {' | '.join(row)} |" for row in (cells[0], kinds, *cells[1:])]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    rules = [["-" * width for width in widths]] if rule else []
    return [
        "  ".join(
            cell.ljust(width) if column < left else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in (cells[0], *rules, *cells[1:])
    ]


def as_csv(titles: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A table as CSV. A cell that is a named tuple becomes a column for each of its fields, `title, field`."""
    fields = [max((getattr(cell, "_fields", ()) for cell in column), key=len) for column in zip(*rows, strict=True)]
    names = [[f"{title}, {field}" for field in parts] or [title] for title, parts in zip(titles, fields, strict=True)]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(itertools.chain(*names))
    for row in rows:
        cells = [cell if isinstance(cell, tuple) else (cell,) for cell in row]
        padded = [(*cell, *[""] * (len(columns) - len(cell))) for cell, columns in zip(cells, names, strict=True)]
        writer.writerow(itertools.chain(*padded))
    return text.getvalue()


def some_of(names: Sequence[str], maximum: int = 8) -> str:
    """Names separated by commas; of many, the first ones and the number of the others."""
    return ", ".join(names[:maximum]) + (f" and {len(names) - maximum} more" if len(names) > maximum else "")


def counted(lines: Iterable[str]) -> list[str]:
    """Each line once, with the number of equal ones."""
    return [line if count == 1 else f"{line} ({count} times)" for line, count in Counter(lines).items()]
