"""TG."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
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
)
