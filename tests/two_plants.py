"""Two machines with a solar plant between them, or with a battery that forms the grid: systems of docs/inverters.md."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "data" / "inverters"
NAMES = ("solar", "battery")


def path(name: str) -> str:
    """The file of a system, as a run names it."""
    return str(FOLDER / f"{name}.yaml")
