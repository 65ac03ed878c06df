"""Optional libraries, installed with an extra of this package and imported on demand."""

from __future__ import annotations

import importlib
from typing import Any

from facts_damping.errors import InputError


def library(module: str, extra: str, name: str = "", where: str = "") -> Any:
    """Import a module of a library; `name`: its usual name; `where`: start of the error message, if any.

    Raises `InputError` if it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = f"{name or module} is not installed; allowed: pip install -e '.[{extra}]' in the checkout"
        raise InputError(f"{where}: {missing}" if where else missing) from error
