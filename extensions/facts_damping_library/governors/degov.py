"""DEGOV: Woodward's governor of a diesel engine, which holds the speed without droop.

Its reference is of speed, so a step of the mechanical power has no effect. Source: PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model
from facts_damping_library.turbines import diesel_engine

ROW = Model(
    "governor",
    "diesel engine without droop",
    "T1 T2 T3 K T4 T5 T6 TD TMAX TMIN",
    diesel_engine("-omega"),
)
