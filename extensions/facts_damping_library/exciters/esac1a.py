"""ESAC1A: IEEE type AC1A (Std 421.5-1992), an alternator with an uncontrolled rectifier.

Without signals of limiters of over- and underexcitation. VAMAX, VAMIN stop the regulator, VRMAX, VRMIN cut its output.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import ac_exciter

ROW = Model(
    "exciter",
    "IEEE type AC1A of 1992, an alternator with a rectifier",
    "TR TB TC KA TA VAMAX VAMIN TE KF TF KC KD KE E1 SE1 E2 SE2 VRMAX VRMIN",
    ac_exciter(
        Block("VA", "lag", "VB", ("KA", "TA"), "VAMIN", "VAMAX"),
        Block("VR", "sum", "VA", (), "VRMIN", "VRMAX"),
    ),
)
