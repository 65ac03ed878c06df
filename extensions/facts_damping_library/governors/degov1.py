"""DEGOV1.

Woodward's governor with droop on its throttle (M = 0) or on the electrical power (M = 1). Torque follows the throttle
after TD, by a Pade approximation of order 10. Source: PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.turbines import diesel_engine

ROW = Model(
    "governor",
    "diesel engine with droop",
    "M T1 T2 T3 K T4 T5 T6 TD TMAX TMIN DROOP TE",
    (
        Block("electrical", "lag", "Pe", (1.0, lambda f: f.TE if f.M else 0.0)),
        Block("error", "sum", "DROOP * Pref - omega - OF_POWER * electrical - OF_THROTTLE * throttle"),
        *diesel_engine("error"),
    ),
    factors={
        "OF_POWER": lambda f: f.DROOP if f.M else 0.0,
        "OF_THROTTLE": lambda f: 0.0 if f.M else f.DROOP,
    },
)
