"""The PSS/E cases inside ANDES's wheel: `make test` fetches it, and unpacks it beside what it installs."""

from __future__ import annotations

import sys
from pathlib import Path

WHEEL = Path(sys.prefix) / "andes"  # unpacked: its folder `andes` has `cases`
CASES = WHEEL / "andes" / "cases"
