"""Common functions for RAW and DYR files: reading lines, and Fortran numbers."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from facts_damping.errors import InputError
from facts_damping.input_files import GRID, is_file, read_text
from facts_damping.parameters.validation import short

if TYPE_CHECKING:
    from pathlib import Path


def read_lines(path: Path, kind: str) -> list[str]:
    """The lines of a file; `kind`: RAW or DYR."""
    if not is_file(path):
        raise InputError(f"{path}: no such file; allowed: an existing PSS/E {kind} file")
    return read_text(path, GRID, "replace").splitlines()


def as_number(text: str, where: str) -> float:
    """A finite number; its exponent may be marked by D."""
    try:
        value = float(re.sub(r"[dD]", "E", text.strip("'\"")))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {short(text)} given; allowed: a number")
    return value
