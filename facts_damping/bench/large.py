"""The large case: the power pool of the North-East (NPCC), whose PSS/E files come inside ANDES.

20 s of 140 buses and 48 machines with exciters, governors and stabilisers. From 1.0 to 1.1 s a three-phase fault at
bus 37 through a reactance of 0.02 p.u., as in `grid`.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from facts_damping.bench.grid import FAULT_END, FAULT_START, FAULT_X

NAME = "NPCC"
BUS = 37
REPEATS = 3


def files() -> tuple[Path, Path]:
    """RAW and DYR; ANDES is found, but not loaded."""
    found = find_spec("andes")
    cases = Path(str(found.origin)).parent / "cases" / "npcc" if found else Path()
    return cases / "npcc.raw", cases / "npcc_full.dyr"


CASE = (
    f"20 s of {NAME}, 140 buses and 48 machines with controls, from the RAW and DYR inside ANDES; three-phase fault at "
    f"bus {BUS} through j {FAULT_X:g} p.u. from {FAULT_START:g} to {FAULT_END:g} s, one core. error: of a swing over "
    "the largest swing, against the same program with a finer step."
)
