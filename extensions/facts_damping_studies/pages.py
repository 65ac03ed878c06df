"""Saves the pictures of studies."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.output.picture_files import save_picture

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

DPI = 85


def save(figure: Figure, path: Path) -> Path:
    """Write a picture as PNG and return its path. The same picture always gives the same file."""
    return save_picture(figure, path, dpi=DPI, metadata={"Software": None})
