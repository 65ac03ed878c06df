"""WPIDHY.

REG is the droop on the electrical power, and negative. A PID gives the velocity of the gate: (KP + KI / s + s KD) over
(1 + s TA)^2 (1 + s TB). Of its first part over 1 + s TA, GAIN = KP - TA KI is the gain; without TA there is no rate.
The curve goes through (G0, 0), (G1, P1), (G2, P2), (1, P3) and on straight. Sources: PSS/E Model Library;
PowerSimulationsDynamics.jl.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.turbines import GATE

ROW = Model(
    "governor",
    "hydro turbine with Woodward's PID governor",
    "TREG REG KP KI KD TA TB VELMX VELMN GATMX GATMN TW PMAX PMIN D G0 G1 P1 G2 P2 P3",
    (
        Block("droop", "lag", "Pe - Pref", ("REG", "TREG")),
        Block("error", "sum", "droop - omega"),
        Block("integral", "integral", "error", ("KI",)),
        Block("rate", "rate", "error", (lambda f: f.KD - f.TA * (f.KP - f.TA * f.KI), "TA")),
        Block("PID", "lag", "GAIN * error + integral + rate", (1.0, "TA")),
        Block("servo", "lag", "PID", (1.0, "TB")),
        Block("velocity", "sum", "servo", (), "VELMN", "VELMX"),
        Block("gate", "integral", "velocity", (1.0,), "GATMN", "GATMX"),
        GATE,
        Block("turbine", "lead_lag", "steady", (1.0, lambda f: -f.TW, lambda f: 0.5 * f.TW)),
        Block("power", "sum", "turbine", (), "PMIN", "PMAX"),
        Block("Pm", "sum", "power - D * omega"),
    ),
    factors={"GAIN": lambda f: f.KP - f.TA * f.KI},
)
