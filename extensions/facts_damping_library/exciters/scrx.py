"""SCRX."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import GAIN_REDUCTION

ROW = Model(
    "exciter",
    "static exciter fed by the terminals (CSWITCH 0) or by a constant source (1)",
    "TATB TB K TE EMIN EMAX CSWITCH RCRFD",
    (
        GAIN_REDUCTION,
        Block("VR", "lag", "VB", ("K", "TE"), "EMIN", "EMAX"),
        Block("supply", "sum", "SOLID * one + FED * Vt"),
        Block("Efd", "product", "VR + supply"),
    ),
    "RCRFD",
    {"SOLID": lambda f: float(f.CSWITCH == 1.0), "FED": lambda f: float(f.CSWITCH != 1.0)},
)
