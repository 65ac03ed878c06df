"""What has passed is skipped until any of its inputs changes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests import passed

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[1]
TEST = """
from tests.passed import inputs

pytestmark = inputs(contents=["src/*.txt"], names=["data/**/*"])


def test_it(): assert open("src/one.txt").read() != "bad"


def test_other(): pass
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A test and its inputs."""
    texts = {"test_it.py": TEST, "src/one.txt": "1", "data/a/one.txt": "1", "tests/conftest.py": "", "pytest.ini": ""}
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "pytest.ini").write_text("[pytest]\nmarkers = inputs: of a file\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.delenv("ALL", raising=False)
    return tmp_path


def pytest_summary(*arguments: str) -> str:
    """The last line of a run of the project's tests."""
    program = str(Path(sys.executable).with_name("pytest"))
    command = [program, "-q", "-p", "tests.passed", "-p", "no:cacheprovider", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return str(done.stdout.strip().splitlines()[-1])


def test_file_of_tests_is_skipped_when_it_has_passed_as_a_whole(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (project / "src" / "one.txt").write_text("bad", encoding="utf-8")
    assert pytest_summary().startswith("1 failed, 1 passed")
    assert pytest_summary().startswith("1 failed, 1 passed")  # what failed is not known as passed
    (project / "src" / "one.txt").write_text("1", encoding="utf-8")
    assert pytest_summary("test_it.py::test_it").startswith("1 passed")  # a part of the file
    assert pytest_summary().startswith("2 passed")
    assert pytest_summary().startswith("2 skipped")
    monkeypatch.setenv("ALL", "1")
    assert pytest_summary().startswith("2 passed")


def write(name: str, text: str) -> Callable[[Path], None]:
    """A change of a project: a file that is written."""

    def change(project: Path) -> None:
        (project / name).parent.mkdir(parents=True, exist_ok=True)
        (project / name).write_text(text, encoding="utf-8")

    return change


@pytest.mark.parametrize(
    "change",
    [
        write("src/one.txt", "2"),
        write("src/two.txt", "1"),
        lambda project: (project / "src" / "one.txt").rename(project / "src" / "two.txt"),
        lambda project: (project / "src" / "one.txt").unlink(),
        write("data/a/b/two.txt", ""),
        lambda project: (project / "data" / "a" / "one.txt").unlink(),
        write("test_it.py", f"{TEST}\n"),
        write("tests/conftest.py", "# other"),
    ],
)
def test_key_of_a_file_of_tests_depends_on_all_its_inputs(project: Path, change: Callable[[Path], None]) -> None:
    def key() -> str:
        return passed.key(project / "test_it.py", project, ["src/*.txt"], ["data/**/*"])

    before = key()
    write("data/a/one.txt", "only its name counts")(project)
    write("src/not.json", "not named")(project)
    assert key() == before
    change(project)
    assert key() != before


@pytest.mark.parametrize("what", ["distributions", "sys", "shutil"])
def test_packages_python_and_programs_count(project: Path, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    changes = {
        "distributions": list,
        "sys": type("Other", (), {"version": "4.0"}),
        "shutil": type("Other", (), {"which": staticmethod(lambda _: sys.executable)}),
    }

    def key() -> str:
        passed._environment.cache_clear()
        return passed.key(project / "test_it.py", project, [], [])

    before = key()
    monkeypatch.setattr(passed, what, changes[what])
    assert key() != before
    monkeypatch.undo()
    passed._environment.cache_clear()


def test_folder_is_bounded(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = project / "cache" / "facts_damping" / "passed"
    folder.mkdir(parents=True)
    for number in range(passed.KEPT + 20):
        (folder / f"{number}").touch()
    assert pytest_summary().startswith("2 passed")
    assert len(list(folder.iterdir())) == passed.KEPT
