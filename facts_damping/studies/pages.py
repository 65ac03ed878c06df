"""What the pages and pictures of studies share: a row's figures, PNG files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.terminal import save_picture

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

DPI = 85


def at(row: Any, path: Sequence[str]) -> Any:
    """What stands in a row of a study at the end of a path of keys."""
    for key in path:
        row = row[key]
    return row


def save(figure: Figure, path: Path) -> Path:
    """Write a picture; the same picture gives the same file. Returns where it is."""
    return save_picture(figure, path, dpi=DPI, metadata={"Software": None})
