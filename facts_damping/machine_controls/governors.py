"""Turbines and governors as tables of blocks."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

GOVERNORS = {
    "TGOV1": Model(
        "governor",
        "steam turbine with a governor",
        "R T1 VMAX VMIN T2 T3 DT",
        (
            Block("valve", "lag", "Pref - GAIN * omega", (1.0, "T1"), "VMIN", "VMAX"),
            Block("reheat", "lead_lag", "valve", (1.0, "T2", "T3")),
            Block("Pm", "sum", "reheat - DT * omega"),
        ),
        factors={"GAIN": lambda f: 1.0 / f.R},
    ),
    "IEEEG1": Model(
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
    ),
    "IEESGO": Model(
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
    ),
    "TG": Model(
        "governor",
        "turbine and governor of PST (`tg`); TW: water starting time, 0 for steam",
        "R TS TC T3 TW T5 VMAX",
        (
            Block("order", "sum", "Pref - GAIN * omega", (), 0.0, "VMAX"),
            Block("servo", "lag", "order", (1.0, "TS")),
            Block("turbine", "lead_lag", "servo", (1.0, "T3", "TC")),
            Block("Pm", "lead_lag", "turbine", (1.0, lambda f: -f.TW, "T5")),
        ),
        factors={"GAIN": lambda f: 1.0 / f.R},
        record=False,
    ),
}
