"""Controllers that were not tuned for a grid say so, with a command that tunes them; others do not."""

from __future__ import annotations

import re
import shlex
from typing import TYPE_CHECKING

import pytest

from facts_damping.analysis.run_warnings import NOT_TUNED, untuned
from facts_damping.case.loading import load_case, recorded_case
from facts_damping.cli.main import main
from facts_damping.errors import InputError
from facts_damping.parameters.files import read_table, shipped
from facts_damping.parameters.yaml_text import dump

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def grid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A file of another grid, with a short scenario beside it."""
    monkeypatch.chdir(tmp_path)
    system = {**read_table(shipped("systems")["smib"]), "name": "other"}
    (tmp_path / "grid.yaml").write_text(dump(system))
    event = {"time": 0.1, "kind": "fault", "line": "line_1", "location": 0.5, "duration": 0.05}
    (tmp_path / "event.yaml").write_text(dump({"name": "event", "duration": 0.5, "events": [event]}))
    return "grid.yaml"


@pytest.mark.parametrize("run", shipped("runs"))
def test_shipped_runs_are_tuned(run: str) -> None:
    assert not untuned(load_case(run).document())


@pytest.mark.parametrize("kind", ["LLC", "LQG", "ANFTSC"])
def test_defaults_on_the_thesis_system_are_no_finding(kind: str) -> None:
    assert not untuned(load_case(None, [f"controllers.0.name={kind}", "controllers.0.signals=[w13]"]).document())


@pytest.mark.parametrize("kind", ["LLC", "LQG", "Hinf", "HBsWC"])
@pytest.mark.parametrize("profile", [None, "deployment"])
def test_defaults_on_another_grid_are_said_also_of_what_was_recorded(grid: str, kind: str, profile: str | None) -> None:
    sets = [f"system={grid}", "scenario=event.yaml", f"controllers.0.name={kind}"]
    case = load_case(None, [*sets, *([f"profile={profile}"] if profile else [])])
    (line,) = untuned(case.document())
    assert line.startswith(f"{kind} is not tuned for other with {case.controllers[0].signals[0]} and sssc")
    assert f"facts-damping tune {grid} {'LLC-tuned' if kind == 'LLC' else kind} " in line
    assert ("--profile deployment" in line) == (profile is not None)
    assert untuned(recorded_case(case.document(), "recording").document()) == [line]


@pytest.mark.parametrize("field", ["controllers.0.parameters.gain=10", "controllers.0.policy=mine.py:Mine"])
def test_given_parameters_and_classes_are_no_finding(grid: str, field: str, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("class Mine:\n    def step(self, t, y):\n        return 0.0\n")
    sets = [f"system={grid}", "scenario=event.yaml", field]
    case = load_case(None, [*sets, *(["controllers.0.name=mine"] if "policy" in field else [])])
    assert not untuned(case.document())


@pytest.mark.parametrize("kind", ["LLC", "LQG"])
def test_command_of_the_warning_tunes_and_applies(
    grid: str, kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = ["simulate", "--set", f"system={grid}", "--set", "scenario=event.yaml", "--set", f"controllers.0.name={kind}"]
    assert main(run) == 0
    said = next(line for line in capsys.readouterr().out.splitlines() if NOT_TUNED in line)
    tune, apply = re.findall("`([^`]*)`", said)
    assert main([*shlex.split(tune)[1:], "--budget", "1", "--jobs", "1"]) == 0
    assert "--set tuning=tuned.yaml" in capsys.readouterr().out
    assert main([*run, *shlex.split(apply)]) == 0
    assert NOT_TUNED not in capsys.readouterr().out
    (row,) = read_table(tmp_path / "tuned.yaml")["controllers"]
    sets = [*run[2::2], *shlex.split(apply)[1::2]]
    case = load_case(None, sets)
    assert row["parameters"].items() <= case.controllers[0].parameters.items()
    (tmp_path / "tuned.yaml").unlink()
    again = recorded_case(case.document(), "recording")  # a recording does without the file
    assert again.controllers == case.controllers


def test_parameters_of_another_grid_are_refused(grid: str, tmp_path: Path) -> None:
    (tmp_path / "tuned.yaml").write_text(shipped("controllers")["two_area"].read_text())
    with pytest.raises(InputError, match="tuning: parameters for two_area given; allowed: those for other"):
        load_case(None, [f"system={grid}", "scenario=event.yaml", "tuning=tuned.yaml"])


def test_margin_says_it(grid: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["margin", "--set", f"system={grid}", "--set", "scenario=event.yaml"]) == 0
    assert NOT_TUNED in capsys.readouterr().out
