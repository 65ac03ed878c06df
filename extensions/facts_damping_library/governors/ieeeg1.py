"""IEEEG1."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "governor",
    "steam turbine of IEEE type 1; all its power acts on one shaft",
    "JBUS JM K T1 T2 T3 UO UC PMAX PMIN T4 K1 K2 T5 K3 K4 T6 K5 K6 T7 K7 K8",
    (
        Block("speed", "lead_lag", "omega", ("K", "T2", "T1")),
        Block("valve", "servo", "Pref - speed", ("T3", "UC", "UO"), "PMIN", "PMAX"),
        Block("P4", "lag", "valve", (1.0, "T4")),
        Block("P5", "lag", "P4", (1.0, "T5")),
        Block("P6", "lag", "P5", (1.0, "T6")),
        Block("P7", "lag", "P6", (1.0, "T7")),
        Block("Pm", "sum", "K12 * P4 + K34 * P5 + K56 * P6 + K78 * P7"),
    ),
    "JBUS JM",
    {
        "K12": lambda f: f.K1 + f.K2,
        "K34": lambda f: f.K3 + f.K4,
        "K56": lambda f: f.K5 + f.K6,
        "K78": lambda f: f.K7 + f.K8,
    },
)
