"""EXST1: IEEE type ST1 (Committee Report of 1981); Efd lies between VRMIN Vt - KC Ifd and VRMAX Vt - KC Ifd."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST1 of 1981, a static exciter fed by the terminals",
    "TR VIMAX VIMIN TC TB KA TA VRMAX VRMIN KC KF TF",
    (
        VOLTAGE_SEEN,
        Block("VF", "rate", "VR", ("KF", "TF")),
        Block("VI", "sum", "Vref + Vs - VT - VF", (), "VIMIN", "VIMAX"),
        Block("VB", "lead_lag", "VI", (1.0, "TC", "TB")),
        Block("VR", "lag", "VB", ("KA", "TA")),
        Block("supplied", "sum", "VR + KC * Ifd", (), "VRMIN", "VRMAX", "Vt", "Vt"),
        Block("Efd", "sum", "supplied - KC * Ifd"),
    ),
)
