"""All controls that are tables of blocks, and unit, meaning and range of their fields by name.

Sources: IEEE Std 421.5 (exciters, stabilisers); IEEE Committee Report, Dynamic Models for Steam and Hydro Turbines in
Power System Studies, 1973 (governors); IEEE Committee Report, Excitation System Models for Power System Stability
Studies, 1981 (EXST1, IEEEST); PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model, Quantity
from facts_damping.machine_controls.exciters import EXCITERS
from facts_damping.machine_controls.governors import GOVERNORS
from facts_damping.machine_controls.stabilisers import STABILISERS

MODELS: dict[str, Model] = {**EXCITERS, **GOVERNORS, **STABILISERS}


# What stands for `input` and `input_2` of a stabiliser by its code IC; 2 is the frequency of a bus, for which the speed
# of the machine stands; 0: there is none.
INPUTS = {0: "none", 1: "omega", 2: "omega", 3: "Pe", 4: "Pa", 5: "Vt"}
_COUNTS = {"SWITCH", "CSWITCH", "JBUS", "JM", "IC", "IC2", "IB", "IB2", "M", "N"}


def quantity_of(name: str) -> Quantity:
    """Unit, meaning and range of a field, by its name: those of the library's data sheets."""
    if name in _COUNTS:
        return Quantity("-", "as in the library", 0.0, 1e6)
    if name[0] == "T" and name not in ("TATB", "THETAP"):
        return Quantity("s", "time constant", 0.0, 1000.0, time=True)
    if name[0] == "A" and name[1:].isdigit():
        return Quantity("s, s²", "coefficient of a filter", 0.0, 1000.0)
    if name == "R":
        return Quantity("p.u.", "droop: speed per power", 0.001, 10.0)
    if name in ("KA", "K"):
        return Quantity("p.u.", "gain", 1e-3, 1e4)
    words = {"K": "gain", "V": "limit", "E": "voltage of the exciter"}
    return Quantity("p.u.", words.get(name[0], "as in the library"))
