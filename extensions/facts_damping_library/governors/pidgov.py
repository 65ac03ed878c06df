"""PIDGOV.

The droop is on the electrical power (M = 0) or on the gate (M = 1). The water column is linear, with ATW TW seconds.
The curve goes through (G0, 0), (G1, P1), (G2, P2), (1, P3) and on straight. Source: PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.turbines import GATE

ROW = Model(
    "governor",
    "hydro turbine with a PID governor",
    "M RPERM TREG KP KI KD TA TB DTURB G0 G1 P1 G2 P2 P3 GMAX GMIN ATW TW VELMAX VELMIN",
    (
        Block("droop", "lag", "Pref - POWER * Pe - GATE * gate", ("RPERM", "TREG")),
        Block("error", "sum", "droop - omega"),
        Block("integral", "integral", "error", ("KI",)),
        Block("PI", "lag", "KP * error + integral", (1.0, "TA")),
        Block("rate", "rate", "error", ("KD", "TA")),
        Block("PID", "lag", "PI + rate", (1.0, "TA")),
        Block("gate", "servo", "PID", ("TB", "VELMIN", "VELMAX"), "GMIN", "GMAX"),
        GATE,
        Block("turbine", "lead_lag", "steady", (1.0, lambda f: -f.ATW * f.TW, lambda f: 0.5 * f.ATW * f.TW)),
        Block("Pm", "sum", "turbine - DTURB * omega"),
    ),
    factors={"POWER": lambda f: 0.0 if f.M else 1.0, "GATE": lambda f: 1.0 if f.M else 0.0},
)
