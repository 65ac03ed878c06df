"""What the pages and pictures of studies share: rows of tables in Markdown, a row's figures, PNG files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

DPI = 85


def line(cells: Sequence[str]) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(cells)} |"


def heads(left: Sequence[str], right: Sequence[str]) -> list[str]:
    """The beginning of a table in Markdown: titles of columns aligned to the left and to the right."""
    return [line([*left, *right]), line(["---"] * len(left) + ["--:"] * len(right))]


def at(row: Any, path: Sequence[str]) -> Any:
    """What stands in a row of a study at the end of a path of keys."""
    for key in path:
        row = row[key]
    return row


def save(figure: Figure, path: Path) -> None:
    """Write a picture; the same picture gives the same file."""
    figure.savefig(path, dpi=DPI, metadata={"Software": None})
