"""ESST3A."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import COMPOUND_SOURCE, VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST3A of 1992, a static exciter with an inner loop of the field voltage",
    "TR VIMAX VIMIN KM TC TB KA TA VRMAX VRMIN KG KP KI VBMAX KC XL VGMAX THETAP TM VMMAX VMMIN",
    (
        VOLTAGE_SEEN,
        Block("VI", "sum", "Vref + Vs - VT", (), "VIMIN", "VIMAX"),
        Block("VA", "lead_lag", "VI", (1.0, "TC", "TB")),
        Block("VR", "lag", "VA", ("KA", "TA"), "VRMIN", "VRMAX"),
        *COMPOUND_SOURCE,
        Block("VG", "limiter", "KG * Efd", (), None, "VGMAX"),
        Block("VM", "lag", "VR - VG", ("KM", "TM"), "VMMIN", "VMMAX"),
        Block("Efd", "product", "VB + VM"),
    ),
)
