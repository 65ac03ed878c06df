"""SCRX: a static exciter of PSS/E, fed by its terminals (CSWITCH 0) or by a constant source (1).

A bridge without negative current has RCRFD above 0: while Ifd is negative, the resistor RC of its crowbar carries it,
Efd = -(RC/RFD) Ifd. RCRFD 0: the bridge carries current of both signs.
"""

from __future__ import annotations

from math import inf

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
        Block("bridge", "product", "VR + supply"),
        Block("Efd", "window", "Ifd + bridge - RCRFD * Ifd", (lambda f: 0.0 if f.RCRFD > 0.0 else -inf, inf)),
    ),
    factors={"SOLID": lambda f: float(f.CSWITCH == 1.0), "FED": lambda f: float(f.CSWITCH != 1.0)},
    optional="RCRFD",
)
