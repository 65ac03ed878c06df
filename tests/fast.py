"""The tests that a change most likely breaks, within seconds of processor: `pytest --fast 25`.

Changed files are those that differ from what is committed, or else of the last commit. First come the tests that were
changed, then those of the same name as a changed file (`tests/plant/test_ports.py` of `plant/ports.py`), then those of
its folder; then others, by how many tests a second of processor buys, as tests/data/budgets.yaml has it.
"""

from __future__ import annotations

import subprocess
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import pytest

from tests.budgets import Cost, recorded

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

FOLDERS = ("tests", "examples")
UNKNOWN = Cost(0.3, 1)  # of a file that is not on record
_CHOSEN = pytest.StashKey[set[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option."""
    parser.addoption("--fast", type=float, metavar="SECONDS", help="what a change most likely breaks, within seconds")


def pytest_configure(config: pytest.Config) -> None:
    """Choose files before any is loaded."""
    seconds = config.getoption("fast")
    if seconds is not None:
        record = recorded()
        paths = [path for folder in FOLDERS for path in (config.rootpath / folder).rglob("test_*.py")]
        files = {path.relative_to(config.rootpath).as_posix() for path in paths}
        config.stash[_CHOSEN] = chosen({name: record.get(name, UNKNOWN) for name in files}, changed(), seconds)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out the files that are not chosen."""
    chosen_files = config.stash.get(_CHOSEN, None)
    if chosen_files is None or collection_path.suffix != ".py":
        return None
    return collection_path.relative_to(config.rootpath).as_posix() not in chosen_files or None


def changed() -> list[str]:
    """Paths of changed files, relative to the root."""
    status = _git("status", "--porcelain", "--untracked-files=all", "--no-renames")
    return [line[3:] for line in status] or _git("diff", "--name-only", "HEAD~1", "HEAD")


def _git(*arguments: str) -> list[str]:
    done = subprocess.run(["git", *arguments], capture_output=True, text=True, check=False)
    return done.stdout.splitlines()


def chosen(files: dict[str, Cost], changed: Collection[str], seconds: float) -> set[str]:
    """Files of tests that fit into the seconds, the nearest to a change first; those that were changed in any case."""
    fitting = {name for name in files if name in changed}
    left = seconds - sum(files[name].seconds for name in fitting)
    by_worth = sorted(
        files, key=lambda name: (-_nearness(name, changed), files[name].seconds / files[name].tests, name)
    )
    for name in by_worth:
        if name not in fitting and files[name].seconds <= left:
            fitting.add(name)
            left -= files[name].seconds
    return fitting


def _rooms(path: PurePosixPath) -> set[str]:
    """Room of a file, its wing and the rooms in that, by the names of their folders in `tests`."""
    if path.parts[0] == "extensions":
        return {part.removeprefix("facts_damping_") for part in path.parts[1:-1]}
    return set(path.parts[1:-1][:1]) if path.parts[0] in ("facts_damping", "tests") else set()


def _nearness(test: str, changed: Collection[str]) -> int:
    """2: the tests of a changed file; 1: of another one in its folder; 0: neither."""
    folder, stem = PurePosixPath(test).parent.parts[1:], PurePosixPath(test).stem.removeprefix("test_")
    nearest = 0
    for path in map(PurePosixPath, changed):
        if folder and folder[0] in _rooms(path):
            nearest = max(nearest, 2 if path.stem == stem else 1)
        elif path.stem == stem:
            nearest = max(nearest, 1)
    return nearest
