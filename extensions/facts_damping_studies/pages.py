"""Pictures of studies: lines above them, their legend, how they are saved; tables as CSV; warnings as lines."""

from __future__ import annotations

import csv
import io
import itertools
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from facts_damping.analysis.run_warnings import untuned
from facts_damping.output.picture_files import save_picture

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from facts_damping.case.model import Case

DPI = 85
PER_INCH = 13  # characters of a line above a picture


def save(figure: Figure, path: Path) -> Path:
    """Write a picture as PNG and return its path. The same picture always gives the same file."""
    return save_picture(figure, path, dpi=DPI, metadata={"Software": None})


def headline(figure: Figure, lines: Sequence[str]) -> None:
    """Add lines above a picture, below what is there, wrapped to its width."""
    width = int(PER_INCH * figure.get_figwidth())
    texts = [text for line in [*figure.get_suptitle().splitlines(), *lines] for text in wrap(line, width)]
    if texts:
        figure.suptitle("\n".join(texts), fontsize="small")


def legend(figure: Figure, **place: Any) -> None:
    """One legend of all labels in a picture; none if there are none."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        entries.update(dict(zip(labels, handles, strict=True)))
    entries.pop("", None)
    if entries:
        figure.legend(entries.values(), entries, fontsize="small", frameon=False, **place)


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


def untuned_lines(case: Case) -> list[str]:
    """Lines about controllers that are not tuned for the system of a case."""
    return [f"warning: {line}" for line in untuned(case.document())]
