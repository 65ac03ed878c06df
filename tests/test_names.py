"""Words that were given up stay out of code, files and pages; what the glossary names is where it says."""

from __future__ import annotations

import ast
import re
import subprocess
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from facts_damping.errors import OLD_NAMES

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")

# Given up, and the word instead.
OLD = {
    **OLD_NAMES,
    "Voice": "NodeLog",
    "SAYING": "PUBLISHER_QOS",
    "HEARING": "SUBSCRIBER_QOS",
    "Guard": "MessageFilter",
    "Blow": "GraphFault",
    "Struck": "FaultedRun",
    "Heard": "TopicState, ServerState, NewMessages",
    "sift": "drop_foreign",
    "sifting": "validation",
    "halves(": "run_half_ticks",
    "go_on(": "advance_with_pmus",
    "inner_life": "controller_health",
    "look_inside": "read_health",
    "pass_on": "forward_setpoints",
    "take_off": "subtract_epoch",
    "unfolded(": "expand_axis",
    "made_scenarios": "scenario_generation",
    "strains": "limit_violations",
    "inner life": "health",
    "unit trip": "mechanical power step",
    "swing mode": "electromechanical mode",
    "MOST_TICKS": "MAX_TICKS",
}
ENGLISH = {"share", "station", "stations"}  # words that also mean something else
TOPS = ("facts_damping", "extensions")
KEPT = ("CHANGELOG.md", "tests/test_names.py", "facts_damping/errors.py")


@cache
def tree_of(path: Path) -> ast.Module:
    """Syntax of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def texts() -> list[tuple[str, str]]:
    """Names and contents of what the repository holds as text."""
    command = ["git", "ls-files", "*.py", "*.md", "*.yaml", "*.msg", "*.srv", "*.toml", "*.yml"]
    listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()
    return [(name, (ROOT / name).read_text(encoding="utf-8")) for name in listed if name not in KEPT]


@pytest.mark.parametrize("old", sorted(set(OLD) - ENGLISH))
def test_word_that_was_given_up_stays_out(old: str) -> None:
    word = re.compile(rf"(?<![\w.]){re.escape(old)}" + ("" if old.endswith("(") else r"\b"))
    places = [f"{name}: {OLD[old]}, not {old}" for name, text in texts() if word.search(text)]
    assert places == []


def test_glossary_leads_to_files_that_are_there() -> None:
    places = re.findall(r"`([a-z_]+(?:/[a-z_]+)*(?:/|\.py))`", GLOSSARY)
    assert len(places) > 20
    assert [place for place in places if not any((ROOT / top / place).exists() for top in TOPS)] == []


def defined(path: Path) -> set[str]:
    """Functions of a module, and methods as `Class.method`."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    return names | {
        f"{cls.name}.{node.name}" for cls in classes for node in cls.body if isinstance(node, ast.FunctionDef)
    }


def test_frame_goes_through_files_and_functions_that_are_there() -> None:
    table = re.findall(r"^\| \d+ \|.*\| (.+) \|$", ARCHITECTURE, re.MULTILINE)
    assert len(table) == 10
    for file, functions in re.findall(r"`([\w/]+\.py)`: (`[\w.]+`(?:, `[\w.]+`)*)", "\n".join(table)):
        assert set(re.findall(r"`([\w.]+)`", functions)) <= defined(ROOT / "facts_damping" / file), file
    places = re.findall(r"`((?:[a-z_]+/)*[a-z_]+\.py)`", ARCHITECTURE)
    assert [place for place in places if not any((ROOT / top / place).exists() for top in ("facts_damping", "."))] == []


# They say where a value came from, not what it is.
VAGUE = {"found", "given", "got", "kept", "made", "one", "own", "taken", "told"}


def variables(path: Path) -> Iterator[tuple[str, int]]:
    """Parameters and variables of a file, with their lines; without fields of classes, functions and imports."""
    nodes = list(ast.walk(tree_of(path)))
    statements = [statement for node in nodes if isinstance(node, ast.ClassDef) for statement in node.body]
    fields = {id(field) for field in (getattr(statement, "target", None) for statement in statements) if field}
    for node in nodes:
        if isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and id(node) not in fields:
            yield node.id, node.lineno
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
            yield node.name, node.lineno


def test_variables_say_what_they_are() -> None:
    tops = (*TOPS, "reproduction", "benchmarks", "docs", "tests")
    paths = [path for top in tops for path in sorted((ROOT / top).rglob("*.py"))]
    vague = [(path.name, *pair) for path in paths for pair in variables(path) if pair[0] in VAGUE]
    assert vague == []


NO_SUBJECT = tuple(f"test_{word}_" for word in ("a", "an", "the", "what", "it", "that", "who"))


def test_tests_are_named_by_their_subject() -> None:
    paths = [path for top in ("tests", "examples", "reproduction") for path in sorted((ROOT / top).rglob("*.py"))]
    functions = [
        (path.name, name)
        for path in paths
        for name in re.findall(r"^ *(?:async )?def (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert len(functions) > 1000
    assert [pair for pair in functions if pair[1].startswith(NO_SUBJECT)] == []


def test_core_files_and_functions_stay_small() -> None:
    """The core has at most 40,000 lines, a file fewer than 350, a function at most 60."""
    paths = [path for top in TOPS for path in (ROOT / top).rglob("*.py")]
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in paths}
    assert sum(count for path, count in lines.items() if path.is_relative_to(ROOT / TOPS[0])) <= 40_000
    assert {path.name: count for path, count in lines.items() if count >= 350} == {}
    nodes = [node for path in lines for node in ast.walk(tree_of(path))]
    functions = [node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)]
    assert [node.name for node in functions if (node.end_lineno or 0) - node.lineno >= 60] == []


def test_no_function_has_more_than_eight_parameters() -> None:
    """`self` and `cls` do not count; values that belong together are one."""
    paths = [path for top in (*TOPS, "reproduction", "benchmarks") for path in sorted((ROOT / top).rglob("*.py"))]
    functions = [
        (path, node)
        for path in paths
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    assert len(functions) > 3000
    counts = {
        f"{path.name} {node.name}": sum(
            isinstance(part, ast.arg) and part.arg not in ("self", "cls") for part in ast.walk(node.args)
        )
        for path, node in functions
    }
    assert {name: count for name, count in counts.items() if count > 8} == {}


def test_no_folder_has_more_than_twenty_modules() -> None:
    folders = {path.parent for top in TOPS for path in (ROOT / top).rglob("*.py")}
    crowded = {folder.name: sum(module.name != "__init__.py" for module in folder.glob("*.py")) for folder in folders}
    assert {name: count for name, count in crowded.items() if count > 20} == {}
