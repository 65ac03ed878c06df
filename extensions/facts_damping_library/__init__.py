"""Controls of machines, and inverters, as in the PSS/E library, a file per model: a row of blocks with its constants.

`exciters`, `governors`, `stabilisers` and `inverters` have a file `name.py` with a `ROW` for each model: a new file is
a new model.
Sources: IEEE Std 421.5 (exciters, stabilisers); IEEE Committee Report, Dynamic Models for Steam and Hydro
Turbines in Power System Studies, 1973 (governors); IEEE Committee Report, Excitation System Models for Power System
Stability Studies, 1981 (EXST1, EXAC1, IEEEST); PSS/E Model Library; GridPACK (EXDC1, PSSSIM, orders of records);
specifications of WECC's Renewable Energy Modeling Task Force (inverters).
"""

from __future__ import annotations

import importlib
from pkgutil import iter_modules
from typing import TYPE_CHECKING

from facts_damping_library import exciters, governors, inverters, stabilisers

if TYPE_CHECKING:
    from facts_damping.machine_controls.blocks import Model

MODELS: dict[str, Model] = {
    name.upper(): importlib.import_module(f"{role.__name__}.{name}").ROW
    for role in (exciters, governors, stabilisers, inverters)
    for _, name, _ in iter_modules(role.__path__)
}
