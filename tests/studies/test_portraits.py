"""Pictures that a study asks for of each of its points."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path


def test_portraits_are_drawn_of_the_points_that_are_asked_for(tmp_path: Path) -> None:
    asked = ["sweep", "portraits", "--only", "kind=ANFTSC*", "--set", "duration=3", "--jobs", "1"]
    assert main([*asked, "--out", str(tmp_path)]) == 0
    drawn = sorted(path.name for path in tmp_path.glob("portrait_*"))
    assert drawn == ["portrait_ANFTSC_direct.png", "portrait_ANFTSC_indirect.png"]
