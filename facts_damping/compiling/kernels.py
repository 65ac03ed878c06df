"""Decorators of compiled functions: `compiled` for parts, `entry_point` for functions called from outside.

A part is compiled into each entry point that uses it. An entry point is compiled once, for the types of its
annotations, into a C function of pointers and numbers, which Python, other entry points and threads call. Compiled
code is kept in files (`store`), so a process that finds them needs no compiler.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import typing
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling.structs import WORD_TYPES, Array, array_words, is_numbers, kind_of, words_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

C_TYPES: dict[Any, Any] = {float: ctypes.c_double, int: ctypes.c_int64, bool: ctypes.c_uint8, type(None): None}
NUMERIC = (int, float, complex, np.number, np.bool_)
ENTRY_POINTS: dict[str, EntryPoint] = {}  # by symbol


def _with_numba() -> Any:
    from facts_damping.compiling import with_numba  # noqa: PLC0415 (only who compiles needs it)

    return with_numba


class Kernel:
    """A part: a Python function that is compiled into the compiled functions that call it."""

    def __init__(self, function: Callable[..., Any], *, inline: bool = False) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.inline = function, inline

    @functools.cached_property
    def _numba_type_(self) -> Any:
        return _with_numba().part(self)

    @functools.cached_property
    def _alone(self) -> Any:
        return _with_numba().alone(self)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call it in Python for numbers alone, with the same bits; else compile it for the arguments' types."""
        given = (*arguments, *named.values())
        if set(map(type, given)) == {int}:  # quick, for the times of a tick
            return self.py_func(*arguments, **named)
        if all(isinstance(one, NUMERIC) for one in given):
            with np.errstate(all="ignore"):  # compiled code has no warnings
                return self.py_func(*arguments, **named)
        return self._alone(*arguments, **named)


class Primitive:
    """A function with special compiled instructions, defined for Numba; in Python an ordinary function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.name = function.__name__

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


class EntryPoint:
    """A compiled function with a C signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)
        self.py_func, self.__name__ = function, function.__name__
        self.symbol = f"{function.__module__}.{function.__qualname__}"
        ENTRY_POINTS[self.symbol] = self

    @functools.cached_property
    def kinds(self) -> list[Any]:
        """Kinds of the arguments (`structs.kind_of`), from the annotations."""
        hints = typing.get_type_hints(self.py_func, include_extras=True)
        return [kind_of(hints[name]) for name in inspect.signature(self.py_func).parameters]

    @functools.cached_property
    def result(self) -> Any:
        """Type of the result: float, int, bool or None."""
        found = typing.get_type_hints(self.py_func).get("return")
        if found not in C_TYPES:
            raise TypeError(f"{self.symbol}: {found} is returned; allowed: float, int, bool, None")
        return found

    @functools.cached_property
    def _numba_type_(self) -> Any:
        return _with_numba().callee(self)

    @functools.cached_property
    def _words(self) -> Any:
        """Words of the C function's arguments from those in Python: written for their kinds, as a loop is too slow."""
        parts, space = [], {"words": array_words, "refuse": _refuse}
        for i, (name, kind) in enumerate(zip(inspect.signature(self.py_func).parameters, self.kinds, strict=True)):
            kind = typing.get_origin(kind) or kind  # noqa: PLW2901 (of a table, its class)
            space[f"k{i}"], given = kind, f"a{i}, k{i}, {f'{self.__name__}: {name}'!r}"
            if kind in WORD_TYPES:
                parts.append(f"a{i}")
            elif isinstance(kind, Array):
                parts.append(f"*words({given})")
            elif is_numbers(kind):
                parts.append(f"*a{i}")
            else:
                parts.append(f"a{i}.pointer if type(a{i}) is k{i} else refuse({given})")
        names = ", ".join(f"a{i}" for i in range(len(self.kinds)))
        return eval(f"lambda {names}: [{', '.join(parts)}]", space)  # noqa: S307 (of our own text)

    @functools.cached_property
    def _function(self) -> Any:
        from facts_damping.compiling import store  # noqa: PLC0415 (it imports this module)

        types = [C_TYPES[word] for kind in self.kinds for word in words_of(kind)]
        return ctypes.CFUNCTYPE(C_TYPES[self.result], *types)(store.address(self))

    def __call__(self, *arguments: Any) -> Any:
        """Call the C function. Raises `TypeError` if arguments have wrong types."""
        if len(arguments) != len(self.kinds):
            raise TypeError(f"{self.__name__}: {len(arguments)} given; allowed: {len(self.kinds)} arguments")
        found = self._function(*self._words(*arguments))
        return bool(found) if self.result is bool else found


def _refuse(given: Any, kind: Any, where: str) -> None:
    """Refuse what is not of a struct's class."""
    raise TypeError(f"{where}: {type(given).__name__} given; allowed: a {kind.__name__}")


def branching(functions: Sequence[Callable[..., Any]]) -> Any:
    """A compiled function of a code and arguments, which calls the function at that index.

    So a table's rows contain their functions, without a separate list of branches. Higher codes call the last function.
    """
    last = len(functions) - 1
    lines = [f"    if code == {i}:\n        return f{i}(*arguments)\n" for i in range(last)]
    source = f"def call(code, *arguments):\n{''.join(lines)}    return f{last}(*arguments)\n"
    space: dict[str, Any] = {"__name__": __name__} | {f"f{i}": one for i, one in enumerate(functions)}
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
