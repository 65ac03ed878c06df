"""PSS2A."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "stabiliser",
    "IEEE stabiliser of two inputs, integral of accelerating power",
    "IC IB IC2 IB2 M N TW1 TW2 T6 TW3 TW4 T7 KS2 KS3 T8 T9 KS1 T1 T2 T3 T4 VSTMAX VSTMIN",
    (
        Block("W1", "washout", "input", (1.0, "TW1")),
        Block("W2", "washout", "W1", (1.0, "TW2")),
        Block("low", "lag", "W2", (1.0, "T6")),
        Block("W3", "washout", "input_2", (1.0, "TW3")),
        Block("W4", "washout", "W3", (1.0, "TW4")),
        Block("power", "lag", "W4", ("KS2", "T7")),
        Block("tracked", "ramp_tracking", "low + KS3 * power", ("T8", "T9", "M", "N")),
        Block("difference", "sum", "KS1 * tracked - KS1 * power"),
        Block("L1", "lead_lag", "difference", (1.0, "T1", "T2")),
        Block("L2", "lead_lag", "L1", (1.0, "T3", "T4")),
        Block("Vs", "sum", "L2", (), "VSTMIN", "VSTMAX"),
    ),
    "IB IB2",
)
