"""Compiled code: structs own what they point at, and keys say what code depends on."""

from __future__ import annotations

import ast
import dis
import gc
import importlib
import inspect
import re
import struct
import sys
import textwrap
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from facts_damping.case.loading import load_case
from facts_damping.compiling import compiled, entry_point, keys, store
from facts_damping.compiling.functions import ENTRY_POINTS
from facts_damping.compiling.kernels import EntryPoint, Kernel
from facts_damping.compiling.structs import Float1, Struct, Table
from facts_damping.link.transfer import merge
from facts_damping.signals import SETPOINT
from facts_damping.simulation import loop
from facts_damping.simulation.tick import Loop, run_half_ticks

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FunctionType

    from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
ROOMS = ("facts_damping.nodes.transport.packing", "facts_damping_gym.many", "facts_damping.simulation.loop")
# What the C library may do for kernels: one IEEE operation, or moving memory.
EXACT = {"ceil", "floor", "memcpy", "memmove", "memset", "rint", "trunc"}
SHORT = ["duration=0.5", "controllers.0.name=HBsWC", "controllers.0.scheme=indirect"]


class Point(Struct):
    x: Float1
    weight: float
    count: int


class Points(Struct):
    first: Point
    others: Table[Point]
    on: bool


class Bare(Struct):
    x: Float1


@pytest.fixture(scope="module", autouse=True)
def rooms() -> Iterator[None]:
    """All kernels; and `gc.collect` looks only through what comes after them."""
    for room in ROOMS:
        importlib.import_module(room)
    gc.freeze()
    yield
    gc.unfreeze()


def replace(part: Any, before: list[NDArray[Any]]) -> None:
    """Every array of a struct by a copy; `before`: what they were."""
    for name in type(part)._fields:
        value = getattr(part, name)
        if isinstance(value, Struct):
            replace(value, before)
        elif isinstance(value, np.ndarray):
            setattr(part, name, value.copy())
            before.append(value)


@cache
def expected() -> list[NDArray[Any]]:
    parts = loop.build_loop(load_case(None, SHORT))
    run_half_ticks(parts, 0, 2 * 30)
    return [parts.signals.frames, parts.signals.issued, parts.measured.plant_state.x]


@given(ticks=st.lists(st.integers(1, 29), unique=True, max_size=4).map(sorted))
@settings(deadline=None, max_examples=15)
def test_arrays_may_be_replaced_between_any_two_ticks(ticks: list[int]) -> None:
    parts = deepcopy(loop.build_loop(load_case(None, SHORT)))  # its plant is that of other runs
    for first, until in zip([0, *ticks], [*ticks, 30], strict=True):
        run_half_ticks(parts, 2 * first, 2 * until)
        if until < 30:
            before: list[NDArray[Any]] = []
            replace(parts, before)
            for value in before:  # what pointed there would be noticed
                value.view(np.uint8).reshape(-1)[:] = 0xA5
            del before, value
            parts = Loop(*parts)
            gc.collect()
    for array, value in zip(
        [parts.signals.frames, parts.signals.issued, parts.measured.plant_state.x], expected(), strict=True
    ):
        assert array.tobytes() == value.tobytes()


def test_struct_takes_its_types_alone() -> None:
    point = Point(np.zeros(2), 1, 2)
    for wrong, said in (
        (np.zeros(2, np.float32), "float32, 1 axes given; allowed: an array of float64, 1 axes"),
        (np.zeros((2, 2)), "float64, 2 axes given"),
        (np.zeros(4)[::2], "with gaps"),
        ([1.0], "list given"),
    ):
        with pytest.raises(TypeError, match=rf"Point\.x: .*{said}"):
            point.x = wrong  # type: ignore[assignment]
    with pytest.raises(TypeError, match=r"Points\.first: Bare given"):
        Points(Bare(np.zeros(1)), Table([]), True)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="Point: x, weight given; allowed: x, weight, count"):
        Point(np.zeros(1), 1.0)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"run_half_ticks: .* given; allowed: a Loop"):
        run_half_ticks(point, 0, 1)
    with pytest.raises(TypeError, match="3 arguments"):
        run_half_ticks(point, 0)


def variant(source: str, name: str = "step", **names: Any) -> Any:
    space: dict[str, Any] = {"__name__": "facts_damping.variant", **names}
    exec(source, space)
    function: FunctionType = space[name]
    return function


def inner(a: float) -> float:
    return 2.0 * a


def other(a: float) -> float:
    return 3.0 * a


PLAIN = "def step(a):\n    return part(a) + LIMIT"
SAME = [
    "def step(a):\n    # a comment\n\n    return part(a) + LIMIT",
    "def step(a: float) -> float:\n    return part(a) + LIMIT",
    "def step(a):\n    'What it is.'\n    return part(a) + LIMIT",
    "X = 1\n\n\ndef step(a):\n    return (part(a)\n            + LIMIT)",
]
ANOTHER = [
    "def step(a):\n    return part(a) - LIMIT",
    "def step(a):\n    return part(a) + LIMIT + 0.0",
    "def step(a, b=1):\n    return part(a) + LIMIT",
]


def key_of(source: str, part: Any = inner, limit: Any = 1.0) -> str:
    return "\n".join(keys._Walk(variant(source, part=compiled(part), LIMIT=limit)).texts)


@pytest.mark.parametrize("source", SAME)
def test_comments_docstrings_and_annotations_compile_nothing(source: str) -> None:
    assert key_of(source) == key_of(PLAIN)


def test_kernel_key_covers_all_that_the_function_uses() -> None:
    others = [*map(key_of, ANOTHER), key_of(PLAIN, other), key_of(PLAIN, limit=2.0)]
    others += [key_of(PLAIN, limit=np.dtype([("a", "f8")])), key_of(PLAIN, limit=np.ones(3)), key_of(PLAIN, limit=True)]
    assert len({key_of(PLAIN), *others}) == len(others) + 1


def test_of_an_entry_point_that_is_called_types_count_alone() -> None:
    def called(x: float, y: float) -> float:
        return x

    def changed(x: float, y: float) -> float:
        return y

    changed.__qualname__ = called.__qualname__
    first, two = entry_point(called), entry_point(changed)
    assert keys._signature(first) == keys._signature(two)
    assert keys.key(first) != keys.key(two)
    ENTRY_POINTS.pop(first.symbol)


@pytest.mark.parametrize(
    ("changed", "concerned"),
    [
        ("facts_damping.plant.machines.governor", {"derivatives", "observe"}),
        ("facts_damping.link.chain", {"uplink", "downlink"}),
        ("facts_damping.neurofuzzy.consequent", {"forward", "by_inputs"}),
        ("facts_damping.supervision.monitors", {"_process_frames", "_monitor"}),
    ],
)
def test_change_in_a_room_compiles_that_room(changed: str, concerned: set[str]) -> None:
    """Entry points that a function of a module is compiled into."""
    symbols = set()
    for symbol, entry in ENTRY_POINTS.items():
        if any(name.startswith(f"{changed}.") for name in keys._walk(entry).functions):
            symbols.add(symbol.rpartition(".")[2])
    assert concerned <= symbols
    assert not symbols & {"run_half_ticks", "control_step", "advance", "measure_with_pmus", "advance_with_pmus"}


def undefined(code: bytes) -> set[str]:
    """Names that an ELF object file needs from elsewhere."""
    (sections_at,) = struct.unpack_from("<Q", code, 40)
    size, many = struct.unpack_from("<HH", code, 58)
    headers = [struct.unpack_from("<IIQQQQIIQQ", code, sections_at + i * size) for i in range(many)]
    names = set()
    for header in headers:
        if header[1] == 2:  # the table of symbols
            names_at = headers[header[6]][4]
            for at in range(header[4], header[4] + header[5], 24):
                name, _, _, section = struct.unpack_from("<IBBH", code, at)
                if section == 0 and name:
                    end = code.index(b"\0", names_at + name)
                    names.add(code[names_at + name : end].decode())
    return names


def test_kernels_call_no_function_whose_bits_a_processor_chooses() -> None:
    store.prepare(ENTRY_POINTS.values())
    for entry in list(ENTRY_POINTS.values()):
        code = store._read(store.home() / store.file_name(entry))
        assert code is not None
        assert undefined(code) <= EXACT | set(ENTRY_POINTS), entry.symbol


def test_kernels_use_no_negative_index() -> None:
    """Compiled code does not ask whether an index is negative."""
    modules = [module for name, module in sys.modules.items() if name.startswith("facts_damping.")]
    kernels = [
        kernel for module in modules for kernel in vars(module).values() if isinstance(kernel, Kernel | EntryPoint)
    ]
    sources = [
        inspect.getsource(kernel.py_func) for kernel in kernels if kernel.py_func.__name__ != "call"
    ]  # written by `branching`
    assert len(sources) > 300
    for source in sources:
        for node in ast.walk(ast.parse(textwrap.dedent(source))):
            if isinstance(node, ast.Subscript):
                assert not re.search(r"(^|[(,:] *)-\d", ast.unparse(node.slice)), ast.unparse(node)


def test_setpoints_go_as_they_are() -> None:
    """An array of the wrong type is refused by the name of the argument."""
    parts = loop.build_loop(load_case(None, SHORT))
    with pytest.raises(TypeError, match="merge: setpoints: float64, 1 axes given"):
        merge(parts.applied, 0, np.zeros(3), 0)
    assert merge(parts.applied, 0, np.zeros(0, SETPOINT), 0) == 0


def test_globals_that_a_function_loads_are_those_that_dis_names() -> None:
    for entry in ENTRY_POINTS.values():
        code = entry.py_func.__code__
        assert keys.globals_of(code) == {
            instruction.argval for instruction in dis.get_instructions(code) if instruction.opname == "LOAD_GLOBAL"
        }
    inner = compile("def f(x):\n    return [abs(y) for y in x if (lambda z: max(z, 1))(y)]", "f", "exec").co_consts[0]
    assert {"abs", "max"} <= keys.globals_of(inner)
    wide = compile("def f():\n    " + "\n    ".join(f"g{i}" for i in range(400)), "f", "exec").co_consts[0]
    assert keys.globals_of(wide) == {f"g{i}" for i in range(400)}
