"""Decorators of compiled functions: `compiled` for parts, `entry_point` for functions called from outside.

A part is compiled into each entry point that uses it. An entry point is compiled once, for the types of its
annotations, into a C function of pointers and numbers, which Python, other entry points and threads call. Compiled
code is kept in files (`store`), so a process that finds them needs no compiler, and does not load it.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import typing
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling.functions import C_TYPES, EntryFunction, PartFunction, PrimitiveFunction
from facts_damping.compiling.structs import WORD_TYPES, Array, array_words, is_numbers, words_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

NUMERIC = (int, float, complex, np.number, np.bool_)


def _with_numba() -> Any:
    from facts_damping.compiling import with_numba  # noqa: PLC0415 (only who compiles needs it)

    return with_numba


def _address(entry: EntryFunction) -> int:
    from facts_damping.compiling import store  # noqa: PLC0415 (only who calls needs it)

    return store.address(entry)


class Kernel(PartFunction):
    """A part that compiled functions and Python call."""

    @functools.cached_property
    def _numba_type_(self) -> Any:
        return _with_numba().part(self)

    @functools.cached_property
    def _alone(self) -> Any:
        return _with_numba().alone(self)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call it in Python for numbers alone, with the same bits; else compile it for the arguments' types."""
        values = (*arguments, *named.values())
        if set(map(type, values)) == {int}:  # quick, for the times of a tick
            return self.py_func(*arguments, **named)
        if all(isinstance(value, NUMERIC) for value in values):
            with np.errstate(all="ignore"):  # compiled code has no warnings
                return self.py_func(*arguments, **named)
        return self._alone(*arguments, **named)


class Primitive(PrimitiveFunction):
    """A primitive that compiled functions and Python call."""

    @functools.cached_property
    def _numba_type_(self) -> Any:
        return _with_numba().primitive(self.name)

    def __call__(self, *arguments: Any) -> Any:
        """Call the Python function."""
        return self.__wrapped__(*arguments)  # type: ignore[attr-defined]


@Primitive
def call_address(address: int, controller: int, now_ns: int) -> int:
    """The result of the C function at an address."""
    whole = ctypes.c_int64
    return int(ctypes.CFUNCTYPE(whole, whole, whole)(address)(controller, now_ns))


@Primitive
def bits_of(number: float) -> int:
    """The 64 bits of a float as a signed integer."""
    return int(np.float64(number).view(np.int64))


@Primitive
def number_of(bits: int) -> float:
    """The float with these 64 bits."""
    return float(np.int64(bits).view(np.float64))


class EntryPoint(EntryFunction):
    """An entry point that compiled functions and Python call."""

    @functools.cached_property
    def _numba_type_(self) -> Any:
        return _with_numba().callee(self, _address)

    @functools.cached_property
    def _words(self) -> Any:
        """Words of the C function's arguments from those in Python: written for their kinds, as a loop is too slow."""
        parts, space = [], {"words": array_words, "refuse": _refuse}
        for i, (name, kind) in enumerate(zip(inspect.signature(self.py_func).parameters, self.kinds, strict=True)):
            kind = typing.get_origin(kind) or kind  # noqa: PLW2901 (of a table, its class)
            space[f"k{i}"], argument = kind, f"a{i}, k{i}, {f'{self.__name__}: {name}'!r}"
            if kind in WORD_TYPES:
                parts.append(f"a{i}")
            elif isinstance(kind, Array):
                parts.append(f"*words({argument})")
            elif is_numbers(kind):
                parts.append(f"*a{i}")
            else:
                parts.append(f"a{i}.pointer if type(a{i}) is k{i} else refuse({argument})")
        names = ", ".join(f"a{i}" for i in range(len(self.kinds)))
        return eval(f"lambda {names}: [{', '.join(parts)}]", space)  # noqa: S307 (of our own text)

    @functools.cached_property
    def _function(self) -> Any:
        types = [C_TYPES[word] for kind in self.kinds for word in words_of(kind)]
        return ctypes.CFUNCTYPE(C_TYPES[self.result], *types)(_address(self))

    def __call__(self, *arguments: Any) -> Any:
        """Call the C function. Raises `TypeError` if arguments have wrong types."""
        if len(arguments) != len(self.kinds):
            raise TypeError(f"{self.__name__}: {len(arguments)} given; allowed: {len(self.kinds)} arguments")
        returned = self._function(*self._words(*arguments))
        return bool(returned) if self.result is bool else returned


def _refuse(value: Any, kind: Any, where: str) -> None:
    """Refuse what is not of a struct's class."""
    raise TypeError(f"{where}: {type(value).__name__} given; allowed: a {kind.__name__}")


def branching(functions: Sequence[Callable[..., Any]]) -> Any:
    """A compiled function of a code and arguments, which calls the function at that index.

    So a table's rows contain their functions, without a separate list of branches. Higher codes call the last function.
    """
    last = len(functions) - 1
    lines = [f"    if code == {i}:\n        return f{i}(*arguments)\n" for i in range(last)]
    source = f"def call(code, *arguments):\n{''.join(lines)}    return f{last}(*arguments)\n"
    space: dict[str, Any] = {"__name__": __name__} | {f"f{i}": function for i, function in enumerate(functions)}
    exec(source, space)  # noqa: S102 (a call for each, in one function)
    return Kernel(space["call"])


if TYPE_CHECKING:  # signatures for type checkers
    import numba

    compiled = inlined = numba.njit(cache=True, error_model="numpy")

    def entry_point(function: Callable[..., Any]) -> Any:
        """Compile a function for the types of its annotations."""
else:
    compiled, entry_point = Kernel, EntryPoint
    inlined = functools.partial(Kernel, inline=True)
