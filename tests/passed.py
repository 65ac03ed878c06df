"""Tests that need not run again: those of a file whose inputs are what they were when it passed.

A file says its inputs by `pytestmark = inputs(contents=[...], names=[...])`: patterns below the root of files whose
contents matter, and of files of which only the names do. The file itself, `tests/conftest.py`, this module, Python,
every installed package and the programs that tests call matter always. `make test ALL=1` runs all, as CI does.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import sys
from collections import defaultdict
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

PROGRAMS = ("chromium", "gcc", "g++", "cmake")
KEPT = 100  # files that say what passed
ALL = bool(os.environ.get("ALL"))
_passed: dict[tuple[str, int], set[str]] = defaultdict(set)  # by key and number of tests: which passed


def inputs(contents: Sequence[str], names: Sequence[str] = ()) -> pytest.MarkDecorator:
    """What the tests of a file depend on."""
    return pytest.mark.inputs(contents=contents, names=names)


def folder() -> Path:
    """Where it is written down, outside the clone."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "facts_damping" / "passed"


def key(test: Path, root: Path, contents: Sequence[str], names: Sequence[str]) -> str:
    """Hash of all that the tests of a file depend on."""
    common = (test, root / "tests" / "conftest.py", Path(__file__))
    read = {*(path for path in common if path.exists()), *_matching(root, contents)}
    lines = [_environment()]
    lines += [f"{path} {hashlib.sha256(path.read_bytes()).hexdigest()}" for path in sorted(read)]
    lines += [str(path) for path in sorted(_matching(root, names))]
    return hashlib.sha256("\n".join(lines).replace(f"{root}/", "").encode()).hexdigest()[:32]


def _matching(root: Path, patterns: Iterable[str]) -> set[Path]:
    """Files that any of the patterns names; what Python leaves behind is none."""
    matching = {path for pattern in patterns for path in root.glob(pattern) if path.is_file()}
    return {path for path in matching if path.suffix != ".pyc"}


@cache
def _environment() -> str:
    """Python, installed packages, programs."""
    packages = sorted(f"{distribution.metadata['Name']} {distribution.version}" for distribution in distributions())
    paths = {name: shutil.which(name) for name in PROGRAMS}
    programs = [f"{os.path.realpath(path)} {Path(path).stat().st_size}" for path in paths.values() if path]
    return "\n".join([sys.version, platform.platform(), *packages, *programs])


@pytest.hookimpl(trylast=True)  # after what is left out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip what has passed; give all others the key by which they will be known."""
    by_file: dict[Path, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if item.get_closest_marker("inputs") is not None:
            by_file[item.path].append(item)
    chosen = any(config.getoption(name, None) for name in ("keyword", "markexpr", "deselect", "lf"))
    parts = chosen or any("::" in argument for argument in config.args)
    for path, tests in by_file.items():
        mark = tests[0].get_closest_marker("inputs")
        name = key(path, config.rootpath, **mark.kwargs) if mark else ""
        if (folder() / name).exists() and not ALL:
            for item in tests:
                item.add_marker(pytest.mark.skip(reason="passed with the same inputs; make test ALL=1 runs it"))
        elif not parts:
            for item in tests:
                item.user_properties.append(("inputs", (name, len(tests))))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note what passed, in the process that tells."""
    inputs_read: Any = dict(report.user_properties).get("inputs")
    if inputs_read is not None and report.when == "call" and report.passed:
        _passed[tuple(inputs_read)].add(report.nodeid)
    elif inputs_read is not None and report.failed:
        _passed[tuple(inputs_read)].discard(report.nodeid)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write down the files whose tests have all passed; the oldest go."""
    if hasattr(session.config, "workerinput"):
        return
    whole = [name for (name, many), tests in _passed.items() if len(tests) == many]
    if whole:
        folder().mkdir(parents=True, exist_ok=True)
    for name in whole:
        (folder() / name).touch()
    for old in sorted(folder().glob("*"), key=lambda path: path.stat().st_mtime)[:-KEPT]:
        old.unlink(missing_ok=True)
