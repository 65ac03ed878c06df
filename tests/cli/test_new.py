"""The folder that `new controller` writes does what it says: it runs, its study is one, its own tests pass."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from facts_damping.cli.main import main
from facts_damping_studies.sweeps.sweep import plan
from tests.commands import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path


def test_its_own_tests_pass_in_process_and_as_a_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "controller", "my_damper"]) == 0
    output = capsys.readouterr().out
    assert output.startswith("my_damper: my_damper.py, run.yaml, study.yaml, test_my_damper.py\n")
    assert "class MyDamper:" in (tmp_path / "my_damper" / "my_damper.py").read_text()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(command, cwd=tmp_path / "my_damper", capture_output=True, text=True, check=False)
    assert "2 passed" in done.stdout, done.stdout
    assert done.returncode == 0
    monkeypatch.chdir(tmp_path / "my_damper")
    assert len(plan("study.yaml", []).points) == 13
    assert (
        main(["simulate", "run.yaml", "--set", "duration=1", "--set", "system=smib", "--set", "scenario=nominal"]) == 0
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["controller", "My-Damper"], "NAME: 'My-Damper' given; allowed: small letters, digits and _"),
        (["controller", "../up"], "NAME: '../up' given"),
        (["controller", "there"], "there: exists already; allowed: a new folder, --out DIR"),
        (["grid", "mine"], "argument kind: 'grid' given; allowed: controller, key"),
    ],
)
def test_bad_names_are_one_line_and_write_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.py").touch()
    assert_one_line(2, ["new", *arguments], said, capsys)
    assert [path.name for path in tmp_path.rglob("*")] == ["there", "mine.py"]
