"""Tables as data frames of pandas, which is imported where one is asked for."""

from __future__ import annotations

import importlib
from typing import Any

from facts_damping.errors import InputError


def data_frame(content: Any) -> Any:
    """A DataFrame of columns by name, or of rows. Raises `InputError` where pandas is not installed."""
    try:
        pandas = importlib.import_module("pandas")
    except ImportError as error:
        raise InputError("pandas is not installed; allowed: pip install 'facts_damping[pandas]'") from error
    return pandas.DataFrame(content)
