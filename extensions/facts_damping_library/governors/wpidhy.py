"""WPIDHY: hydro turbine with Woodward's PID governor, which gives the velocity of the gate.

REG, which is negative, is the droop on the electrical power. The PID (KP + KI / s + s KD) / (1 + s TA) is parted into
an integral, a gain KP - TA KI and a rate (KD - TA KP + TA^2 KI) s / (1 + s TA); a lag TA and a lag TB follow it.
Without TA there is no rate. Sources: PSS/E Model Library; PowerSimulationsDynamics.jl, InterPSS (lags, their order).
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.turbines import hydro_turbine

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
        *hydro_turbine(lambda f: f.TW),
        Block("power", "sum", "turbine", (), "PMIN", "PMAX"),
        Block("Pm", "sum", "power - D * omega"),
    ),
    factors={"GAIN": lambda f: f.KP - f.TA * f.KI},
)
