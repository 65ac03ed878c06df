"""GAST: gas turbine with a governor, whose fuel the temperature of the exhaust limits.

The fuel is the lower of the governor's, Pref - omega / R, and AT + KT (AT - exhaust): `load` is both, less
KT (AT - exhaust) and over 1 + KT, so that AT is its limit. Exhaust: a lag T3 of the power.
Source: PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "governor",
    "gas turbine with a governor",
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
