"""Tables as text."""

from __future__ import annotations

import csv
import io
import itertools
import textwrap
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


WIDEST = 120  # characters of a line in a terminal
NARROWEST = 14  # of a column that is wrapped


def table(
    titles: Sequence[str],
    rows: Iterable[Sequence[Any]],
    left: int = 1,
    *,
    markdown: bool = False,
    rule: bool = True,
    widest: int | None = None,
) -> list[str]:
    """Lines of a table for a terminal, or in Markdown; `rule`: a line below the titles, which are left out if empty.

    The first `left` columns are aligned to the left, the others to the right. Cells are wrapped, from the widest column
    on, until no line is longer than `widest`.
    """
    cells = [list(titles), *([str(cell) for cell in row] for row in rows)]
    if markdown:
        kinds = ["---" if column < left else "--:" for column in range(len(titles))]
        return [f"| {' | '.join(row)} |" for row in (cells[0], kinds, *cells[1:])]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    while widest is not None and sum(widths) + 2 * (len(widths) - 1) > widest and max(widths) > NARROWEST:
        widths[widths.index(max(widths))] -= 1
    rules = [["-" * width for width in widths]] if rule else []
    wrapped = partial(textwrap.wrap, subsequent_indent="  ", break_on_hyphens=False)
    shown = [cells[0], *rules, *cells[1:]] if any(titles) else cells[1:]
    return [
        "  ".join(
            line.ljust(width) if column < left or line != cell else line.rjust(width)
            for column, (cell, line, width) in enumerate(zip(row, lines, widths, strict=True))
        ).rstrip()
        for row in shown
        for lines in itertools.zip_longest(*map(wrapped, row, widths), fillvalue="")
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
