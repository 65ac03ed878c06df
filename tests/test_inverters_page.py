"""What docs/inverters.md says is so: its systems, its models, its inputs, what the command prints."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.cli.main import main
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.plant.inverters.inverter import SETPOINTS
from tests import two_plants

if TYPE_CHECKING:
    import pytest

TEXT = (Path(__file__).parents[1] / "docs" / "inverters.md").read_text(encoding="utf-8")


def test_systems_are_those_of_the_tests() -> None:
    blocks = re.findall(r"^```yaml\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
    assert blocks == [Path(two_plants.path(name)).read_text(encoding="utf-8") for name in two_plants.NAMES]


def test_tables_have_all_models_and_all_inputs() -> None:
    first_cells = re.findall(r"^\| `(\w+)` \|", TEXT, re.MULTILINE)
    assert first_cells == ["input", *SETPOINTS]
    (table,) = re.findall(r"^\| sort .*?\n\n", TEXT, re.DOTALL | re.MULTILINE)
    models = {name for name, row in MODELS.items() if row.role in ("inverter", "inverter_control")}
    assert set(re.findall(r"`(\w+)`", table)) == models


def test_ranking_is_what_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    shown = re.search(r"^    \$ facts-damping (design solar\.yaml .*)\n((?:    .*\n)+)", TEXT, re.MULTILINE)
    assert shown
    command, *options = shown[1].split()[0:1] + shown[1].split()[2:]
    assert main([command, two_plants.path("solar"), *options, "--jobs", "1"]) == 0
    printed = capsys.readouterr().out
    lines = [line[4:] for line in shown[2].splitlines() if line.strip() != "..."]
    assert len(lines) == 7
    for line in lines:
        assert f"{line}\n" in printed
