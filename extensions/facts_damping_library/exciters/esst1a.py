"""ESST1A: IEEE type ST1A (Std 421.5-1992), a static exciter fed by the terminals, with a limiter of the field current.

VOS 1: the stabiliser acts at the input, 2: behind the regulator. The field current takes KLR (Ifd - ILR) off where it
is above ILR. Efd lies between VRMIN Vt and VRMAX Vt - KC Ifd. No underexcitation limiter acts, whatever UEL is.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST1A of 1992, a static exciter fed by the terminals",
    "UEL VOS TR VIMAX VIMIN TC TB TC1 TB1 KA TA VAMAX VAMIN VRMAX VRMIN KC KF TF KLR ILR",
    (
        VOLTAGE_SEEN,
        Block("VF", "rate", "asked", ("KF", "TF")),
        Block("VI", "sum", "Vref + BEFORE * Vs - VT - VF", (), "VIMIN", "VIMAX"),
        Block("VB", "lead_lag", "VI", (1.0, "TC", "TB")),
        Block("VB1", "lead_lag", "VB", (1.0, "TC1", "TB1")),
        Block("VA", "lag", "VB1", ("KA", "TA"), "VAMIN", "VAMAX"),
        Block("VL", "limiter", "KLR * Ifd - OVER * one", (), 0.0),
        Block("asked", "sum", "VA + BEHIND * Vs - VL"),
        Block("raised", "sum", "asked", (), "VRMIN", None, "Vt"),
        Block("supplied", "sum", "raised + KC * Ifd", (), None, "VRMAX", "one", "Vt"),
        Block("Efd", "sum", "supplied - KC * Ifd"),
    ),
    "UEL",
    {
        "BEFORE": lambda f: float(f.VOS != 2.0),
        "BEHIND": lambda f: float(f.VOS == 2.0),
        "OVER": lambda f: f.KLR * f.ILR,
    },
)
