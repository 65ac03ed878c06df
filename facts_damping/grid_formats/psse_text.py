"""What RAW and DYR files share: lines of a file, and numbers as Fortran writes them."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from facts_damping.errors import InputError
from facts_damping.parameters.validation import short

if TYPE_CHECKING:
    from pathlib import Path

LONGEST = 50_000_000  # bytes of a file


def read_lines(path: Path, kind: str) -> list[str]:
    """The lines of a file; `kind`: RAW or DYR."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; allowed: an existing PSS/E {kind} file")
    if path.stat().st_size > LONGEST:
        raise InputError(f"{path}: {path.stat().st_size} bytes given; allowed: at most {LONGEST}")
    return path.read_text(encoding="utf-8", errors="replace").splitlines()


def as_number(text: str, where: str) -> float:
    """A finite number; its exponent may have a D."""
    try:
        value = float(re.sub(r"[dD]", "E", text.strip("'\"")))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {short(text)} given; allowed: a number")
    return value
