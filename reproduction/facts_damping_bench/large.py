"""The large case: the power pool of the North-East (NPCC), whose PSS/E files come inside ANDES.

140 buses and 48 machines, 21 of them classical, with 24 exciters and 29 governors; duration and fault are those of
`grid`, the fault at bus 37.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from facts_damping.errors import InputError
from facts_damping_bench.grid import Shown, fault_at
from facts_damping_bench.programs import LARGE, missing

BUS = 37
REPEATS = 3
SHOWN = Shown(
    "NPCC",
    "NPCC (140 buses; 48 machines, 21 of them classical; 24 exciters, 29 governors; from the RAW and DYR inside ANDES)",
    fault_at(f"bus {BUS}"),
)


def check() -> None:
    """Raise `InputError` where ANDES, and so the files, are not there."""
    if lacking := missing(LARGE["andes"].distributions):
        raise InputError(f"--large: its files come inside ANDES: {lacking}; allowed: with ANDES")


def files() -> tuple[Path, Path]:
    """RAW and DYR; ANDES is found, but not loaded."""
    spec = find_spec("andes")
    assert spec is not None  # noqa: S101 (`check`)
    cases = Path(str(spec.origin)).parent / "cases" / "npcc"
    return cases / "npcc.raw", cases / "npcc_full.dyr"
