"""What is compiled: parts, primitives, and entry points with their C signatures; `kernels` makes them callable."""

from __future__ import annotations

import ctypes
import functools
import inspect
import typing
from typing import TYPE_CHECKING, Any

from facts_damping.compiling.structs import kind_of

if TYPE_CHECKING:
    from collections.abc import Callable

C_TYPES: dict[Any, Any] = {float: ctypes.c_double, int: ctypes.c_int64, bool: ctypes.c_uint8, type(None): None}
ENTRY_POINTS: dict[str, EntryFunction] = {}  # by symbol


class PartFunction:
    """A part: a Python function that is compiled into the compiled functions that call it."""

    def __init__(self, function: Callable[..., Any], *, inline: bool = False) -> None:
        functools.update_wrapper(self, function)  # type: ignore[arg-type] # `kernels` has its `__call__`
        self.py_func, self.inline = function, inline


class PrimitiveFunction:
    """A function with special compiled instructions, defined for Numba; in Python an ordinary function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)  # type: ignore[arg-type] # `kernels` has its `__call__`
        self.name = function.__name__


class EntryFunction:
    """A compiled function with a C signature."""

    def __init__(self, function: Callable[..., Any]) -> None:
        functools.update_wrapper(self, function)  # type: ignore[arg-type] # `kernels` has its `__call__`
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
        hint = typing.get_type_hints(self.py_func).get("return")
        if hint not in C_TYPES:
            raise TypeError(f"{self.symbol}: {hint} is returned; allowed: float, int, bool, None")
        return hint
