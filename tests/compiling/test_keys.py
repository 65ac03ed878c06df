"""A user's compiled law never runs machine code of what it was before: random edits against an empty cache."""

from __future__ import annotations

import ctypes
import importlib
import multiprocessing
import struct
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import TYPE_CHECKING, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from llvmlite import binding

import facts_damping

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

DEEPER = """
from facts_damping.compiling import compiled
FACTOR = {0}.0
@compiled
def factor(x):
    return FACTOR * x
"""
HELPER = """
from enum import IntEnum
from typing import NamedTuple
import numba
import numpy as np
from numba.extending import overload, register_jitable
from facts_damping.compiling import compiled
from {package} import deeper
class Gains(NamedTuple):
    first: float
    second: float
class Level(IntEnum):
    HIGH = {0}
CONSTANT, ARRAY, NESTED, GAINS = {1}.0, np.array([1.0, {2}.0]), (1.0, ({3}.0, 2.0)), Gains(1.0, {4}.0)
@compiled
def scale(x):
    return x * CONSTANT + {5}.0 * deeper.factor(x)
@compiled
def other(x):
    return x + 7.0
def make(k):
    @compiled
    def inside(x):
        return x * k
    return inside
closed = make({6}.0)
@numba.njit
def jitted(x):
    return x - {7}.0
@register_jitable
def jitable(x):
    return x * {8}.0
def taught(x):
    return x
@overload(taught)
def _taught(x):
    return lambda x: x + {9}.0
"""
LAW = """
import {package}.deeper
from {package} import helper
from {package}.helper import {imported} as part
from facts_damping.compiling import compiled, entry_point
@compiled
def with_default(x, gain={0}.0):
    return gain * x
@entry_point
def law(x: float) -> float:
    named = helper.GAINS.second + helper.NESTED[1][0] + helper.ARRAY[1] + helper.Level.HIGH.value
    return named + part(x) + helper.closed(x) + helper.jitted(x) + helper.jitable(x) + with_default(x) + {taught}
"""
# Of packages outside this one, files count as a whole, and what Numba is taught there; within it, what is used.
PACKAGES = {"edited": "helper.taught(x)", "facts_damping.edited": "{package}.deeper.factor(x)"}
DIGITS = 12


def write(package: str, folder: Path, digits: tuple[int, ...], imported: str) -> None:
    """The package's files in a folder."""
    folder.mkdir(exist_ok=True)
    taught = PACKAGES[package].format(package=package)
    texts = {
        "__init__": "",
        "deeper": DEEPER.format(digits[0]),
        "helper": HELPER.format(*digits[1:11], package=package),
        "law": LAW.format(digits[11], package=package, imported=imported, taught=taught),
    }
    for name, text in texts.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")


_cache: dict[str, bytes] = {}  # object code by file name, in the process that compiles


def law_twice(package: str, top: str) -> list[float]:
    """Values of the law as it is in the files now: by code that was compiled for its key before, and compiled now."""
    from facts_damping.compiling import keys, store, with_numba  # noqa: PLC0415 (only the process that compiles)
    from facts_damping.compiling.functions import ENTRY_POINTS  # noqa: PLC0415 (as before)

    sys.dont_write_bytecode = True  # files of one second have one time stamp
    for path in (sys.path, facts_damping.__path__):
        if top not in path:
            path.insert(0, top)
    for name in [name for name in sys.modules if name == package or name.startswith(f"{package}.")]:
        del sys.modules[name]
    importlib.invalidate_caches()
    keys._file_hash.cache_clear()
    entry = importlib.import_module(f"{package}.law").law
    ENTRY_POINTS.pop(entry.symbol)
    code = with_numba.object_code(entry)
    values = []
    for variant in (_cache.setdefault(store.file_name(entry), code), code):
        engine = store._new_engine()
        engine.add_object_file(binding.ObjectFileRef.from_data(variant))
        engine.finalize_object()
        function = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(engine.get_function_address(entry.symbol))
        values.append(function(0.375))
    return values


class Compiler(NamedTuple):
    """A process that compiles, and does nothing else with Numba; where the edited packages are."""

    pool: ProcessPoolExecutor
    top: Path

    def law_twice(self, package: str, digits: tuple[int, ...], imported: str) -> list[float]:
        """Values of an edited law: by the cache, and compiled now."""
        write(package, self.top / "edited", digits, imported)
        return self.pool.submit(law_twice, package, str(self.top)).result(timeout=60)


@pytest.fixture(scope="module")
def compiler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Compiler]:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        shared = Compiler(pool, tmp_path_factory.mktemp("packages"))
        for package in PACKAGES:
            shared.law_twice(package, (1,) * DIGITS, "scale")
        yield shared


@pytest.mark.parametrize("package", PACKAGES)
@given(
    edits=st.dictionaries(st.integers(0, DIGITS - 1), st.integers(1, 9), max_size=2),
    imported=st.sampled_from(["scale", "other"]),
)
@settings(deadline=None, max_examples=25)
def test_edited_law_runs_as_with_an_empty_cache(
    package: str, compiler: Compiler, edits: dict[int, int], imported: str
) -> None:
    digits = tuple(edits.get(i, 1) for i in range(DIGITS))
    cached, fresh = compiler.law_twice(package, digits, imported)
    assert struct.pack("d", cached) == struct.pack("d", fresh)
