"""EXST3."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST3 of 1981, a static exciter fed by voltage and current",
    "TR VIMAX VIMIN KJ TC TB KA TA VRMAX VRMIN KG KP KI EFDMAX KC XL VGMAX THETAP",
    (
        VOLTAGE_SEEN,
        Block("VI", "sum", "Vref + Vs - VT", (), "VIMIN", "VIMAX"),
        Block("VA", "lead_lag", "VI", ("KJ", "TC", "TB")),
        Block("VG", "limiter", "KG * Efd", (), None, "VGMAX"),
        Block("VR", "lag", "VA - VG", ("KA", "TA"), "VRMIN", "VRMAX"),
        Block("VE", "source", "Vd + Vq + Id + Iq", ("KP", "THETAP", "KI", "XL")),
        Block("VB", "rectifier", "VE + Ifd", ("KC",)),
        Block("supplied", "product", "VB + VR"),
        Block("Efd", "sum", "supplied", (), None, "EFDMAX"),
    ),
)
