"""DEGOV.

Woodward's governor holds the speed; its reference is of speed, so a step of the mechanical power has no effect. Torque
follows the throttle after TD, by a Pade approximation of order 10. Source: PSS/E Model Library.
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
