"""A hash key of everything that an entry point's compiled code depends on: all functions and constants used.

For a function, instructions, constants and default arguments count; docstring, annotations, comments and position do
not. For another entry point only name and types count, since it is called, not compiled in. Of modules outside this
package the whole files count, too: Numba may be taught there what a function means (`numba.extending.overload`).
"""

from __future__ import annotations

import dis
import hashlib
import os
import platform
import sys
import types
from enum import EnumMeta
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from facts_damping.compiling.functions import EntryFunction, PartFunction, PrimitiveFunction
from facts_damping.compiling.structs import Struct, described, fingerprint
from facts_damping.errors import InputError

PACKAGE = "facts_damping"
KNOWN = sys.stdlib_module_names | {"numpy", "numba", "llvmlite"}  # modules whose versions are in every key
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
    files = (Path(__file__).with_name(name).read_bytes() for name in ("with_numba.py", "numba_types.py"))
    how = hashlib.sha256(b"".join(files)).hexdigest()
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    kind = f"{sys.platform} {platform.machine()} {target()}"
    bounds = " bounds" if checks_bounds() else ""
    arrays = ".".join(version("numpy").split(".")[:2])
    return f"{python} {version('numba')} {version('llvmlite')} {arrays} {kind} {how}{bounds}"


def _code(code: types.CodeType, docstring: str | None) -> str:
    constants = list(code.co_consts)
    if docstring is not None and constants and constants[0] == docstring:
        constants[0] = None
    parts = [_code(item, None) if isinstance(item, types.CodeType) else _constant(item) for item in constants]
    names = code.co_varnames, code.co_names, code.co_freevars, code.co_argcount, code.co_flags
    return f"{code.co_code.hex()} {names} {parts}"


def _constant(value: Any) -> str:
    """A constant as text that is equal in every process."""
    if isinstance(value, (list, tuple)):
        return f"{type(value).__qualname__}({', '.join(map(_constant, value))})"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_constant(key)}: {_constant(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, (set, frozenset)):
        return f"{type(value).__qualname__}{sorted(map(_constant, value))}"
    if isinstance(value, np.dtype):
        return f"{value.descr}"
    if isinstance(value, (np.ndarray, np.generic)):
        return f"{value.dtype.descr}{value.shape}{value.strides}{hashlib.sha256(value.tobytes()).hexdigest()}"
    name = getattr(value, "__qualname__", getattr(value, "__name__", None))
    if name is not None:
        return f"{getattr(value, '__module__', '')}.{name}"
    kind = type(value)
    stable = kind.__module__ == "builtins" or kind.__module__.startswith("numba.")  # others may tell their address
    return repr(value) if stable else f"{kind.__module__}.{kind.__qualname__}"


def globals_of(code: types.CodeType) -> set[str]:
    """Names of the globals that a function and its inner functions load: as `dis`, in a tenth of its time."""
    names, extended = set(), 0
    for operation, low in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        argument = extended | low
        if operation == LOAD_GLOBAL:
            names.add(code.co_names[argument >> SHIFT])
        extended = argument << 8 if operation == dis.EXTENDED_ARG else 0
    return names.union(*(globals_of(item) for item in code.co_consts if isinstance(item, types.CodeType)))


def _mentioned(code: types.CodeType) -> set[str]:
    """Names of globals and attributes in a function and its inner functions."""
    return set(code.co_names).union(*(_mentioned(item) for item in code.co_consts if isinstance(item, types.CodeType)))


@cache
def _names(function: Any) -> tuple[list[str], frozenset[str]]:
    """The globals that a function loads; and all names of globals and attributes in it."""
    code = function.__code__
    return sorted(globals_of(code) & set(function.__globals__)), frozenset(_mentioned(code))


def _is_known(name: str | None) -> bool:
    """Whether a module is part of Python, NumPy or the compiler."""
    return (name or "").partition(".")[0] in KNOWN


@cache
def _file_hash(path: str) -> str:
    """Hash of a file; nothing for a file that does not exist, as of functions that were typed in."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if Path(path).is_file() else ""


def _signature(entry: EntryFunction) -> str:
    return f"{entry.symbol}{[described(kind) for kind in entry.kinds]}{entry.result}"


class _Walk:
    """Everything reachable from an entry point: texts of the key, and called entry points."""

    def __init__(self, function: Any, entry: EntryFunction | None = None) -> None:
        self.texts: list[str] = []
        self.callees: dict[str, EntryFunction] = {}
        self.functions: set[str] = set()  # functions compiled into it
        self._seen: set[Any] = set()  # ids of functions, structs and enumerations; ids of modules with names looked up
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
        name, code = f"{function.__module__}.{function.__qualname__}", function.__code__
        self.functions.add(name)
        self.texts.append(f"{name} {options} {_code(code, function.__doc__)}")
        self._file(function.__module__, code.co_filename)
        loaded, names = _names(function)
        for default in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).items()):
            self._value("default", default, names)
        for used in loaded:
            self._value(used, function.__globals__[used], names)
        for used, cell in zip(code.co_freevars, function.__closure__ or (), strict=True):
            self._value(used, cell.cell_contents, names)

    def _value(self, name: str, value: Any, names: frozenset[str]) -> None:
        """What a function uses by a name; `names`: all that it mentions, among them attributes of modules."""
        if isinstance(value, EntryFunction):
            self.texts.append(f"{name} {_signature(value)}")
            self.callees[value.symbol] = value
        elif isinstance(value, PartFunction):
            self._function(value.py_func, f"{value.inline}")
        elif isinstance(value, PrimitiveFunction):
            self.texts.append(value.name)
        elif isinstance(value, types.ModuleType):
            self._module(name, value, names)
        elif isinstance(value, type) and issubclass(value, Struct):
            self._struct(value)
        elif isinstance(getattr(value, "py_func", None), types.FunctionType):  # Numba's own decorators
            self._function(value.py_func, _constant(getattr(value, "targetoptions", None)))
        elif isinstance(value, types.FunctionType) and not _is_known(value.__module__):
            self._function(value)
        elif isinstance(value, tuple):
            self.texts.append(f"{name} {type(value).__qualname__} {getattr(value, '_fields', ())}")
            for i, part in enumerate(value):
                self._value(f"{name}.{i}", part, names)
        elif isinstance(value, EnumMeta):
            members = [(member, _constant(getattr(value, member).value)) for member in value.__members__]
            self.texts.append(f"{name} {value.__qualname__} {members}")
        elif isinstance(value, type) and hasattr(value, "_fields"):
            self.texts.append(f"{name} {value.__qualname__} {value._fields}")
        elif isinstance(value, np.ndarray) and not (value.flags.c_contiguous or value.flags.f_contiguous):
            raise InputError(f"{name}: an array with gaps given; allowed in compiled functions: contiguous")
        else:
            self.texts.append(f"{name} {_constant(value)}")
            module = value.__module__ if isinstance(value, type) else type(value).__module__
            self._file(module, getattr(sys.modules.get(module), "__file__", None))

    def _module(self, name: str, module: types.ModuleType, names: frozenset[str]) -> None:
        """Attributes of a module that are mentioned; `names`: as for `_value`."""
        self.texts.append(f"{name} {module.__name__}")
        if _is_known(module.__name__) or (id(module), names) in self._seen:
            return
        self._seen.add((id(module), names))
        self._file(module.__name__, module.__file__)
        for attribute in sorted(names):
            if hasattr(module, attribute):
                self._value(f"{name}.{attribute}", getattr(module, attribute), names)

    def _file(self, module: str | None, path: str | None) -> None:
        """A file of a module outside this package, as a whole."""
        if path is not None and not _is_known(module) and (module or "").partition(".")[0] != PACKAGE:
            self.texts.append(f"{module} {_file_hash(path)}")

    def _struct(self, kind: Any) -> None:
        struct: Any = next(
            (k for k in (kind, *getattr(kind, "__args__", ())) if isinstance(k, type) and issubclass(k, Struct)), None
        )
        if struct is not None and id(struct) not in self._seen:
            self._seen.add(id(struct))
            self.texts.append(f"{struct.__module__}.{struct.__qualname__} {fingerprint(struct)}")


@cache
def _walk(entry: EntryFunction) -> _Walk:
    return _Walk(entry.py_func, entry)


def callees(entry: EntryFunction) -> list[EntryFunction]:
    """Entry points called by an entry point."""
    return list(_walk(entry).callees.values())


@cache
def key(entry: EntryFunction) -> str:
    """Hash of everything that the compiled code of an entry point depends on."""
    return hashlib.sha256("\n".join([_compiler(), *_walk(entry).texts]).encode()).hexdigest()[:20]
