"""EXAC1: IEEE type AC1 (Committee Report of 1981), an alternator with an uncontrolled rectifier."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import ac_exciter

ROW = Model(
    "exciter",
    "IEEE type AC1 of 1981, an alternator with a rectifier",
    "TR TB TC KA TA VRMAX VRMIN TE KF TF KC KD KE E1 SE1 E2 SE2",
    ac_exciter(Block("VR", "lag", "VB", ("KA", "TA"), "VRMIN", "VRMAX")),
)
