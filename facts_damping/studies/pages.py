"""Helpers shared by the pages and pictures of studies: reading nested figures of a row, saving PNG files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.terminal import save_picture

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

DPI = 85


def at(row: Any, path: Sequence[str]) -> Any:
    """The value at the end of a path of keys in a row of a study."""
    for key in path:
        row = row[key]
    return row


def save(figure: Figure, path: Path) -> Path:
    """Write a picture as PNG and return its path. The same picture always gives the same file."""
    return save_picture(figure, path, dpi=DPI, metadata={"Software": None})
