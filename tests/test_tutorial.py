"""The tutorial's YAML blocks, joined, are a valid system: the shipped one; and its runs do what it says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case, load_system
from facts_damping.cli.main import main
from facts_damping.plant.build import build
from facts_damping.plant.grid.power_flow import solve
from facts_damping.simulation import loop
from facts_damping.small_signal.eigenmodes import modes
from facts_damping.small_signal.linearisation import linearise
from facts_damping_studies.sweeps.sweep import plan

if TYPE_CHECKING:
    from facts_damping.small_signal.eigenmodes import Eigenmode

TEXT = (Path(__file__).parents[1] / "docs" / "tutorial_grid.md").read_text(encoding="utf-8")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The tutorial's files: a block whose first line is a file's name begins that, the others go on with the first."""
    files: dict[str, str] = {}
    for block in re.findall(r"```yaml\n(.*?)```", TEXT, re.DOTALL):
        named = re.match(r"# (\w+\.yaml)\n", block)
        name = named[1] if named else "nine_bus.yaml"
        files[name] = files.get(name, "") + block
    runs = {"nine_bus_fault.yaml", "nine_bus_control.yaml"}
    others = {"nine_bus_sssc.yaml", "nine_bus_margin.yaml", "nine_bus_training.yaml"}
    assert set(files) == {"nine_bus.yaml", *others, *runs}
    for name, content in files.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def swings(name: str) -> list[Eigenmode]:
    """The two electromechanical modes by frequency."""
    built = build(load_system(name), [], [])
    eigenmodes = modes(linearise(built)[0], built.state_names)
    return sorted(
        (m for m in eigenmodes if 1 < m.frequency_hz < 3 and m.damping_ratio < 0.1), key=lambda m: m.frequency_hz
    )


def test_blocks_are_the_shipped_system(folder: Path) -> None:
    ours, theirs = load_system("nine_bus.yaml"), load_system("wscc_9")
    our_flow, other = solve(ours), solve(theirs)
    assert our_flow.names == other.names
    np.testing.assert_allclose(our_flow.voltage, other.voltage, rtol=0, atol=1e-12)
    for table in ("buses", "lines", "transformers", "loads", "machines", "exciters", "pmus"):
        assert getattr(ours, table) == getattr(theirs, table)


def test_figures_are_what_comes_out(folder: Path) -> None:
    flow = solve(load_system("nine_bus.yaml"))
    for name, voltage in zip(flow.names, flow.voltage, strict=True):
        assert re.search(rf"{name} +{abs(voltage):.4f} +{np.rad2deg(np.angle(voltage)):.3f} ", TEXT)
    for mode in swings("nine_bus.yaml"):
        value = mode.eigenvalue
        assert re.search(
            rf"{value.real:.5f} +{value.imag:.5f} +{mode.frequency_hz:.4f} +{mode.damping_ratio:.4f}", TEXT
        )


@pytest.mark.parametrize("run", ["nine_bus_fault", "nine_bus_control"])
def test_runs_come_to_their_end(folder: Path, run: str) -> None:
    result = summarise(loop.run(load_case(f"{run}.yaml")))
    assert result.stable is True
    assert f"{result.modes[0].damping_ratio:.4f}" in TEXT
    assert f"{result.modes[0].frequency_hz:.3f}" in TEXT


def test_study_is_of_the_folders_class_and_the_lead_lag(folder: Path) -> None:
    assert main(["new", "controller", "grid_damper"]) == 0
    assert [point.columns["law"] for point in plan("nine_bus_margin.yaml", []).points] == ["grid_damper", "LLC"]
