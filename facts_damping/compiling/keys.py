"""A hash key of everything that an entry point's compiled code depends on: all functions and constants used.

For a function, instructions and constants count; docstring, annotations, comments and position do not. For another
entry point only name and types count, since it is called, not compiled in.
"""

from __future__ import annotations

import dis
import hashlib
import os
import platform
import sys
import types
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from facts_damping.compiling.kernels import EntryPoint, Kernel, Primitive
from facts_damping.compiling.structs import Struct, described, fingerprint

PACKAGE = "facts_damping"
LOAD_GLOBAL, SHIFT = dis.opmap["LOAD_GLOBAL"], int(sys.version_info >= (3, 11))  # the argument has an index and a flag
TARGETS = {
    "x86_64": "x86-64",
    "aarch64": "generic",
}  # baseline processors: all machines of the kind have their instructions


def target() -> str:
    """The target processor: the baseline of this kind."""
    return TARGETS.get(platform.machine(), "generic")


def checks_bounds() -> bool:
    """Whether compiled functions check indices, which makes them slower: Numba's variable NUMBA_BOUNDSCHECK is 1.

    A process that uses an index beyond an array then ends by SIGILL.
    """
    return os.environ.get("NUMBA_BOUNDSCHECK", "") == "1"


@cache
def _compiler() -> str:
    """Identity of the compiler: versions, target, and options of Numba."""
    how = hashlib.sha256(Path(__file__).with_name("with_numba.py").read_bytes()).hexdigest()
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    kind = f"{sys.platform} {platform.machine()} {target()}"
    bounds = " bounds" if checks_bounds() else ""
    return f"{python} {version('numba')} {version('llvmlite')} {kind} {how}{bounds}"


def _code(code: types.CodeType, docstring: str | None) -> str:
    constants = list(code.co_consts)
    if docstring is not None and constants and constants[0] == docstring:
        constants[0] = None
    parts = [_code(c, None) if isinstance(c, types.CodeType) else _constant(c) for c in constants]
    names = code.co_varnames, code.co_names, code.co_freevars, code.co_argcount, code.co_flags
    return f"{code.co_code.hex()} {names} {parts}"


def _constant(value: Any) -> str:
    """A constant as text that is equal in every process."""
    if isinstance(value, frozenset):
        return f"frozenset{sorted(map(repr, value))}"
    if isinstance(value, np.dtype):
        return f"{value.descr}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype.descr}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, types.ModuleType | types.FunctionType | types.BuiltinFunctionType | type | np.ufunc):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', value.__name__)}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_constant, value))})"
    return repr(value)


def globals_of(code: types.CodeType) -> set[str]:
    """Names of the globals that a function and its inner functions load: as `dis`, in a tenth of its time."""
    found, extended = set(), 0
    for operation, low in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        argument = extended | low
        if operation == LOAD_GLOBAL:
            found.add(code.co_names[argument >> SHIFT])
        extended = argument << 8 if operation == dis.EXTENDED_ARG else 0
    return found.union(*(globals_of(one) for one in code.co_consts if isinstance(one, types.CodeType)))


@cache
def _used(function: Any) -> list[tuple[str, Any]]:
    """Names a function refers to: globals, attributes of this package's modules, variables of enclosing functions."""
    code, found = function.__code__, []
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names |= set(constant.co_names)
    for name in sorted(globals_of(code) & set(function.__globals__)):
        value = function.__globals__[name]
        if isinstance(value, types.ModuleType) and value.__name__.startswith(f"{PACKAGE}."):
            found += [(f"{name}.{n}", vars(value)[n]) for n in sorted(names & set(vars(value)))]
        else:
            found.append((name, value))
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    return found + [(name, cell.cell_contents) for name, cell in cells]


def _signature(entry: EntryPoint) -> str:
    return f"{entry.symbol}{[described(kind) for kind in entry.kinds]}{entry.result}"


class _Walk:
    """Everything reachable from an entry point: texts of the key, and called entry points."""

    def __init__(self, function: Any, entry: EntryPoint | None = None) -> None:
        self.texts: list[str] = []
        self.callees: dict[str, EntryPoint] = {}
        self.functions: set[str] = set()  # functions compiled into it
        self._seen: set[int] = set()
        if entry is not None:
            self.texts.append(_signature(entry))
            for kind in entry.kinds:
                self._struct(kind)
        self._function(function)

    def _function(self, function: Any, options: str = "") -> None:
        if id(function) in self._seen:
            self.texts.append(function.__qualname__)
            return
        self._seen.add(id(function))
        name = f"{function.__module__}.{function.__qualname__}"
        self.functions.add(name)
        self.texts.append(f"{name} {options} {_code(function.__code__, function.__doc__)} {function.__defaults__}")
        for name, value in _used(function):
            self._value(name, value)

    def _value(self, name: str, value: Any) -> None:
        if isinstance(value, EntryPoint):
            self.texts.append(f"{name} {_signature(value)}")
            self.callees[value.symbol] = value
        elif isinstance(value, Kernel):
            self._function(value.py_func, f"{value.inline}")
        elif isinstance(value, Primitive):
            self.texts.append(value.name)
        elif isinstance(value, type) and issubclass(value, Struct):
            self._struct(value)
        elif isinstance(value, type) and hasattr(value, "_fields"):
            self.texts.append(f"{name} {value.__qualname__} {getattr(value, '_fields', ())}")
        else:
            self.texts.append(f"{name} {_constant(value)}")

    def _struct(self, kind: Any) -> None:
        own: Any = next(
            (k for k in (kind, *getattr(kind, "__args__", ())) if isinstance(k, type) and issubclass(k, Struct)), None
        )
        if own is not None and id(own) not in self._seen:
            self._seen.add(id(own))
            self.texts.append(f"{own.__module__}.{own.__qualname__} {fingerprint(own)}")


@cache
def _walk(entry: EntryPoint) -> _Walk:
    return _Walk(entry.py_func, entry)


def callees(entry: EntryPoint) -> list[EntryPoint]:
    """Entry points called by an entry point."""
    return list(_walk(entry).callees.values())


@cache
def key(entry: EntryPoint) -> str:
    """Hash of everything that the compiled code of an entry point depends on."""
    return hashlib.sha256("\n".join([_compiler(), *_walk(entry).texts]).encode()).hexdigest()[:20]


def callees_of(function: Any) -> list[EntryPoint]:
    """Entry points called by a part."""
    return list(_Walk(function).callees.values())


def of_function(function: Any) -> str:
    """The key of a part that is compiled by itself, for any types."""
    walk = _Walk(function)
    return hashlib.sha256("\n".join([_compiler(), *walk.texts]).encode()).hexdigest()[:20]
