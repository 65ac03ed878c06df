"""TGOV1."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "governor",
    "steam turbine with a governor",
    "R T1 VMAX VMIN T2 T3 DT",
    (
        Block("valve", "lag", "Pref - GAIN * omega", (1.0, "T1"), "VMIN", "VMAX"),
        Block("reheat", "lead_lag", "valve", (1.0, "T2", "T3")),
        Block("Pm", "sum", "reheat - DT * omega"),
    ),
    factors={"GAIN": lambda f: 1.0 / f.R},
)
