"""GAST.

The fuel is the lower of the governor's order, Pref - omega / R, and of what the temperature of the exhaust allows,
AT + KT (AT - exhaust). `load` is both, less KT (AT - exhaust) and over 1 + KT: so AT is its limit, and also that of the
power at rest. Source: PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "governor",
    "gas turbine with a governor, limited by the temperature of its exhaust",
    "R T1 T2 T3 AT KT VMAX VMIN DTURB",
    (
        Block("load", "sum", "SHARE * Pref - GAIN * omega + REST * exhaust", (), None, "AT"),
        Block("fuel", "lag", "RAISED * load - KT * exhaust", (1.0, "T1"), "VMIN", "VMAX"),
        Block("power", "lag", "fuel", (1.0, "T2")),
        Block("exhaust", "lag", "power", (1.0, "T3")),
        Block("Pm", "sum", "power - DTURB * omega"),
    ),
    factors={
        "SHARE": lambda f: 1.0 / (1.0 + f.KT),
        "GAIN": lambda f: 1.0 / f.R / (1.0 + f.KT),
        "REST": lambda f: f.KT / (1.0 + f.KT),
        "RAISED": lambda f: 1.0 + f.KT,
    },
)
