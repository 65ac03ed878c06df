"""IEESGO."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "governor",
    "IEEE standard turbine and governor",
    "T1 T2 T3 T4 T5 T6 K1 K2 K3 PMAX PMIN",
    (
        Block("speed", "lag", "omega", ("K1", "T1")),
        Block("lead", "lead_lag", "speed", (1.0, "T2", "T3")),
        Block("wanted", "sum", "Pref - lead", (), "PMIN", "PMAX"),
        Block("P4", "lag", "wanted", (1.0, "T4")),
        Block("P5", "lag", "P4", ("K2", "T5")),
        Block("P6", "lag", "P5", ("K3", "T6")),
        Block("Pm", "sum", "HIGH * P4 + MIDDLE * P5 + P6"),
    ),
    factors={"HIGH": lambda f: 1.0 - f.K2, "MIDDLE": lambda f: 1.0 - f.K3},
)
