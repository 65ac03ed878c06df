"""Errors of a script without the lines of this package that lead to them."""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, ParamSpec, TypeVar

from facts_damping.errors import FactsDampingError, RunError

if TYPE_CHECKING:
    from collections.abc import Callable

P = ParamSpec("P")
R = TypeVar("R")


def short_traceback(function: Callable[P, R]) -> Callable[P, R]:
    """Have what a function raises on purpose begin at the script's own line; a `RunError` keeps what caused it."""

    @wraps(function)
    def wrapped(*given: P.args, **named: P.kwargs) -> R:
        try:
            return function(*given, **named)
        except FactsDampingError as error:
            if not isinstance(error, RunError):
                error.__cause__, error.__suppress_context__ = None, True
            raise error.with_traceback(None)  # noqa: B904 (the same error)

    return wrapped
