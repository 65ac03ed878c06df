"""From keywords to a case, as from a run file; errors of a script without the lines of this package before them."""

from __future__ import annotations

import sys
from functools import wraps
from os import PathLike
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from facts_damping.case import loading
from facts_damping.case.changes import as_sets
from facts_damping.errors import FactsDampingError, RunError

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.case.model import Case

P = ParamSpec("P")
R = TypeVar("R")
AS_ARGUMENT = "{path}={value}"  # how errors name what a script gave


def case_of(run: str | PathLike[str] | None, fields: dict[str, Any]) -> Case:
    """The case of a run (name, or path) with some fields changed. Raises `InputError`."""
    content, source = loading.read_run(None if run is None else str(run))
    values = plain(fields)
    return loading.changed_case(content, source, values, as_sets(values, AS_ARGUMENT))


def plain(value: Any) -> Any:
    """A value as YAML would give it: NumPy's numbers and arrays, paths, and classes, which `policy` may name."""
    if isinstance(value, dict):
        return {str(name): plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, type):  # as `policy` has it: by its module, where others find it there; else by its file
        file = getattr(sys.modules.get("__main__"), "__file__", None) if value.__module__ == "__main__" else None
        return f"{file or value.__module__}:{value.__qualname__}"
    return str(value) if isinstance(value, PathLike) else value


def short_traceback(function: Callable[P, R]) -> Callable[P, R]:
    """Have what a function raises on purpose begin at the script's own line; a `RunError` keeps what caused it."""

    @wraps(function)
    def wrapped(*positional: P.args, **named: P.kwargs) -> R:
        try:
            return function(*positional, **named)
        except FactsDampingError as error:
            if not isinstance(error, RunError):
                error.__cause__, error.__suppress_context__ = None, True
            raise error.with_traceback(None)  # noqa: B904 (the same error)

    return wrapped
