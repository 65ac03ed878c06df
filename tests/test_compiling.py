"""The kernels' cache: a change recompiles what depends on it, and no more."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from facts_damping import compiling
from facts_damping.case.loading import load_case
from facts_damping.control import bank
from facts_damping.simulation import loop

PACKAGE = Path(compiling.__file__).parent
ROOMS = [room.replace(".", "/") for room in compiling.ROOMS]
NAMES = [
    f"facts_damping.{'.'.join(path.relative_to(PACKAGE).with_suffix('').parts)}"
    for room in ROOMS
    for path in sorted([*(PACKAGE / room).rglob("[!_]*.py"), *PACKAGE.glob(f"{room}.py")])
]


def imported(tree: ast.Module) -> dict[str, str]:
    """Where each name comes from that a file imports from this package: a module."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("facts_damping"):
            for name in node.names:
                below = f"{node.module}.{name.name}"
                is_module = PACKAGE.parent.joinpath(*below.split(".")).with_suffix(".py").is_file()
                found[name.asname or name.name] = below if is_module else str(node.module)
    return found


def kernels(tree: ast.Module) -> list[ast.FunctionDef]:
    """The compiled functions of a file."""
    return [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.decorator_list]


def test_every_file_with_compiled_functions_is_in_a_room_of_theirs() -> None:
    having = [path for path in PACKAGE.rglob("*.py") if "@compiled" in path.read_text() or "@inner" in path.read_text()]
    modules = {f"facts_damping.{'.'.join(path.relative_to(PACKAGE).with_suffix('').parts)}" for path in having}
    assert modules - {"facts_damping.compiling"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_all_that_kernels_name_of_other_files_counts(name: str) -> None:
    """Functions that they call, constants, and the types of what they are given."""
    tree = ast.parse(PACKAGE.parent.joinpath(*name.split(".")).with_suffix(".py").read_text())
    origins, sources = imported(tree), compiling.sources(name)
    for kernel in kernels(tree):
        names = {node.id for node in ast.walk(kernel) if isinstance(node, ast.Name)}
        assert {origins[one] for one in names & origins.keys()} <= set(sources), kernel.name


@pytest.mark.parametrize(
    ("changed", "concerned", "others"),
    [
        (
            "link.draws",
            {"link.chain", "link.transfer", "simulation.tick"},
            {"plant.integration", "control.bank", "signals"},
        ),
        (
            "plant.governor",
            {"plant.dynamics", "plant.measurement", "simulation.tick"},
            {"link.transfer", "control.identifier"},
        ),
        (
            "neurofuzzy.consequent",
            {"neurofuzzy.network", "control.bank", "simulation.tick"},
            {"plant.ports", "link.transfer"},
        ),
        (
            "simulation.tick",
            {"simulation.tick"},
            {"plant.integration", "control.bank", "control.identifier", "link.transfer"},
        ),
        ("compiling", {"plant.model", "control.bank", "link.chain", "neurofuzzy.network", "simulation.tick"}, set()),
        ("cli.runs", set(), {"plant.integration", "control.bank", "link.transfer", "simulation.tick"}),
    ],
)
def test_a_change_concerns_what_depends_on_it(changed: str, concerned: set[str], others: set[str]) -> None:
    for name in concerned | others:
        assert (f"facts_damping.{changed}" in compiling.sources(f"facts_damping.{name}")) is (name in concerned), name


@pytest.mark.parametrize("where", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME"])
def test_old_folders_of_a_file_go_and_those_of_others_stay(tmp_path: Path, where: str) -> None:
    home = tmp_path if where == "NUMBA_CACHE_DIR" else tmp_path / "facts_damping" / "numba"
    for i in range(6):
        for name in ("facts_damping.simulation.tick", "facts_damping.link.chain"):
            (home / f"{name}-{i}").mkdir(parents=True)
            os.utime(home / f"{name}-{i}", (i, i))
    environment = {**os.environ, where: str(tmp_path)}
    if where == "XDG_CACHE_HOME":
        environment.pop("NUMBA_CACHE_DIR", None)
    code = "from facts_damping import compiling; print(compiling._folder('facts_damping.simulation.tick').name)"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert {p.name for p in home.glob("facts_damping.simulation.tick-*")} == {
        done.stdout.strip(),
        *(f"facts_damping.simulation.tick-{i}" for i in (3, 4, 5)),
    }
    assert len(list(home.glob("facts_damping.link.chain-*"))) == 6


def test_a_function_for_compiled_callers_alone_says_so() -> None:
    limit: Any = bank._limit
    for _ in range(2):
        with pytest.raises(TypeError, match=r"bank\._limit: for compiled callers alone"):
            limit(None, None, 0, 0)
        loop.run(load_case(None, ["duration=0.1"]))  # compiled by then, and known to its callers
