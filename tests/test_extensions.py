"""What is no row of an extension is told in one line; tests/test_additions.py has those that are."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from facts_damping import extending, extensions
from facts_damping.analysis.indices import INDICES, Index
from facts_damping.control.table import ControllerKind
from facts_damping.devices.base import DeviceModel
from facts_damping.devices.table import KINDS
from facts_damping.errors import InputError
from tests.additions import install

ROOT = Path(__file__).parents[1]
POINTS = {"proportional": "one:ROW"}
TABLES: dict[str, Any] = {
    "controlers": ("controllers", ControllerKind),
    "controllers": ("controllers", ControllerKind),
    "indices": ("indices", Index, INDICES),
    "devices": ("devices", DeviceModel),
}


@pytest.mark.parametrize(
    ("text", "groups", "said"),
    [
        (
            "",
            {"controlers": POINTS},
            r"proportional = one:ROW of facts_damping.controlers \(my_extension\): no such group; .*",
        ),
        ("", {"controllers": POINTS}, r".*: AttributeError: .*no attribute 'ROW'; allowed: module:row, .*"),
        ("ROW = 1", {"controllers": POINTS}, r".*: int given; allowed: ControllerKind"),
        ("ROW = 1", {"indices": {"IAE": "one:ROW"}}, r"IAE .*: the name is taken; allowed: another than .*"),
        ("ROW = 1", {"devices": POINTS}, r".*: given alone; allowed: with proportional of facts_damping.device_kinds"),
    ],
)
def test_invalid_row_of_an_extension_is_refused_in_one_line(
    text: str, groups: dict[str, dict[str, str]], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, {"one.py": text}, {f"facts_damping.{name}": points for name, points in groups.items()})
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "one", raising=False)
    caches = (extensions.given, extensions.every)
    try:
        for cache in caches:
            cache.cache_clear()
        with pytest.raises(InputError) as raised:
            extensions.rows(*TABLES[next(iter(groups))])
    finally:
        for cache in caches:
            cache.cache_clear()
    assert re.fullmatch(f"entry point {said}", str(raised.value))


def test_two_packages_with_the_same_row_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("my_extension", "another"):
        install(tmp_path, {}, {"facts_damping.indices": POINTS}, package)
    monkeypatch.syspath_prepend(str(tmp_path))
    extensions.every.cache_clear()
    with pytest.raises(InputError, match=r"the name is taken; .* that of entry point proportional = one:ROW .*\("):
        extensions.every()


def test_command_ends_with_that_line(tmp_path: Path) -> None:
    install(tmp_path, {"one.py": ""}, {"facts_damping.controllers": POINTS})
    command = [sys.executable, "-m", "facts_damping", "simulate", "two_area_small"]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert re.fullmatch(r"facts-damping: entry point proportional = one:ROW .*\n", done.stderr)


FIELDS = """
from typing import Literal
from pydantic import model_validator
from facts_damping.parameters.plant.devices import Series
class Mine(Series):
    kind: Literal["mine"]
    @model_validator(mode="after")
    def _consistent(self):
        return self
"""
KIND = """
import numpy as np
from facts_damping.plant.converters.devices import DeviceKind
from facts_damping.plant.converters.site import Start
def start(device, site):
    return Start((site.offset,), [0.0], 0.0)
ROW = DeviceKind(np.dtype([("offset", "i8")]), ["x"], start, None, None)
"""
USE = """
from facts_damping.parameters.plant.system import Device
from facts_damping.plant.converters.dispatch import CODES
from facts_damping.devices.table import MODELS
print(CODES["mine"])
try:
    MODELS["mine"](name="a", kind="mine", rs=0.1, xs=0.1)
except ValueError as error:
    print("needs either `line`, or `from` and `to`" in str(error))
"""


def test_device_of_an_extension_by_the_pages_of_before(tmp_path: Path) -> None:
    """Two entry points, with imports and a validator as earlier pages show."""
    groups = {f"facts_damping.{group}": {"mine": f"{group}:{name}"} for group, name in
              (("devices", "Mine"), ("device_kinds", "ROW"))}  # fmt: skip
    install(tmp_path, {"devices.py": FIELDS, "device_kinds.py": KIND}, groups)
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = subprocess.run([sys.executable, "-c", USE], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout == f"{list(KINDS).index('svc')}\nTrue\n"  # by its name before `svc`


def test_names_of_extending_are_those_that_type_checkers_see() -> None:
    tree = ast.parse(Path(extending.__file__).read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    here = {name: f"facts_damping.{room}" for name, room in extending.NAMES.items()}
    assert seen == here | dict.fromkeys(extending.MODULES, "facts_damping")
    assert all(getattr(extending, name) is not None for name in dir(extending))
    with pytest.raises(AttributeError, match=r"it has .*Antecedent, Block, Consequent"):
        _ = extending.Nothing


@pytest.mark.parametrize(
    ("module", "names"),
    [
        ("facts_damping.analysis.indices", ["Index"]),
        ("facts_damping.cli.options", ["common"]),
        ("facts_damping.compiling", ["compiled"]),
        ("facts_damping.control.table", ["ControllerKind", "Parameter", "powers"]),
        ("facts_damping.environment", ["NAME"]),
        ("facts_damping.environment.window", ["Window"]),
        ("facts_damping.link.stages", ["DRAWN", "StageKind"]),
        ("facts_damping.neurofuzzy.table", ["Antecedent", "Consequent", "H", "S", "Variant", "W"]),
        ("facts_damping.parameters.base", ["quantity"]),
        ("facts_damping.parameters.plant.devices", ["Parallel"]),
        ("facts_damping.parameters.stages", ["StageModel"]),
        ("facts_damping.plant.converters.devices", ["DeviceKind"]),
        ("facts_damping.plant.converters.site", ["Start"]),
        ("facts_damping.recording", ["load", "recover"]),
        ("facts_damping.report", ["write"]),
        ("facts_damping.simulation.changes", ["rerun"]),
        ("facts_damping.testing", ["Loopback", "loopback"]),
    ],
)
def test_imports_that_earlier_pages_show_still_work(module: str, names: list[str]) -> None:
    assert all(hasattr(importlib.import_module(module), name) for name in names)
