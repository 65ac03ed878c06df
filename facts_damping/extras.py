"""Libraries that are installed with an extra of this package: imported where they are asked for."""

from __future__ import annotations

import importlib
from typing import Any

from facts_damping.errors import InputError


def library(module: str, extra: str, name: str = "", where: str = "") -> Any:
    """A module of a library, which people call `name`; `where`: begins the error, if there is one.

    Raises `InputError` where it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = f"{name or module} is not installed; allowed: pip install 'facts_damping[{extra}]'"
        raise InputError(f"{where}: {missing}" if where else missing) from error
