"""The case of WECC-240: the loss of a nuclear unit, 2.4 GW, in a grid with machines and inverters.

243 buses, 103 machines, 37 inverters, no stabilisers, from the RAW and DYR of `config/references`; duration is that of
`grid`. ANDES understands some records otherwise than PSS/E: ours is put as it has them, and it is given the files as
they are meant, as in the validation (README.md of `config/references`). What is compared has the same equations.
"""

from __future__ import annotations

from facts_damping_bench.grid import FAULT_START, Shown
from facts_damping_validation.wecc240 import TRIP

UNIT = str(TRIP["machine"])
REPEATS = 1  # ANDES takes minutes for each
SHOWN = Shown(
    "WECC-240",
    "WECC-240 (243 buses; 103 machines, 103 exciters, 103 governors, 37 inverters; no stabilisers)",
    f"loss of {UNIT} (2.4 GW) at {FAULT_START:g} s",
    finer=4,
)
