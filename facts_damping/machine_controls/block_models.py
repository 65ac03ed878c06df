"""All controls that are tables of blocks, and unit, meaning and range of their fields by name.

They come from installed packages, those of the PSS/E library from `facts_damping_library`.
"""

from __future__ import annotations

from typing import Any

from facts_damping.errors import InputError
from facts_damping.extensions import rows
from facts_damping.machine_controls.blocks import Block, Model, Quantity

MODELS: dict[str, Model] = {}
for package, models in rows("machine_controls", dict).items():
    if MODELS.keys() & models:
        raise InputError(
            f"machine_controls: {package}: {', '.join(MODELS.keys() & models)} given; allowed: other names"
        )
    MODELS |= models

# What stands for `input` and `input_2` of a stabiliser by its code IC; 2 is the frequency of a bus, for which the speed
# of the machine stands; 0: there is none.
INPUTS = {0: "none", 1: "omega", 2: "omega", 3: "Pe", 4: "Pa", 5: "Vt"}
_COUNTS = {
    *("SWITCH", "CSWITCH", "SW1", "JBUS", "JM", "IC", "IC2", "IB", "IB2", "M", "N"),
    *("UEL", "OEL", "SCL", "VOS", "IBLOCK", "CKT"),
}
_NO_TIMES = {
    *("TATB", "THETAP", "T1T3", "T2T4", "TMAX", "TMIN", "Thld"),
    *("Theta0", "TetaMax", "TetaMin", "Temax", "Temin", "TRATE"),
}


def active_blocks(data: Any) -> list[Block]:
    """The blocks of a model that its fields ask for."""
    return [block for block in MODELS[data.model].blocks if block.when is None or block.when(data)]


def quantity_of(name: str) -> Quantity:
    """Unit, meaning and range of a field, by its name: those of the library's data sheets."""
    if name in _COUNTS or name.startswith("BUS"):
        return Quantity("-", "as in the library", 0.0, 1e6)
    if name.lower().endswith(("flag", "lvplsw")):
        return Quantity("-", "flag", 0.0, 1.0)
    if name[0] == "T" and name not in _NO_TIMES:
        return Quantity("s", "time constant", 0.0, 1000.0, time=True)
    if name[0] == "A" and name[1:].isdigit():
        return Quantity("s, s²", "coefficient of a filter", 0.0, 1000.0)
    if name == "R":
        return Quantity("p.u.", "droop: speed per power", 0.001, 10.0)
    if name in ("KA", "K"):
        return Quantity("p.u.", "gain", 1e-3, 1e4)
    words = {"K": "gain", "V": "limit", "E": "voltage of the exciter"}
    return Quantity("p.u.", words.get(name[0], "as in the library"))
