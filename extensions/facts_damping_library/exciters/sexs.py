"""SEXS: a simplified excitation system of PSS/E: one lead-lag (TATB is its numerator over TB) and one lag."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import GAIN_REDUCTION

ROW = Model(
    "exciter",
    "simplified excitation system",
    "TATB TB K TE EMIN EMAX",
    (GAIN_REDUCTION, Block("Efd", "lag", "VB", ("K", "TE"), "EMIN", "EMAX")),
)
