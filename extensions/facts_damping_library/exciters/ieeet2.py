"""IEEET2."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN, A, B

ROW = Model(
    "exciter",
    "IEEE type 2 of 1968, rate feedback from the regulator",
    "TR KA TA VRMAX VRMIN KE TE KF TF1 TF2 E1 SE1 E2 SE2",
    (
        VOLTAGE_SEEN,
        Block("rate", "rate", "VR", ("KF", "TF1")),
        Block("VF", "lag", "rate", (1.0, "TF2")),
        Block("VR", "lag", "Vref + Vs - VT - VF", ("KA", "TA"), "VRMIN", "VRMAX"),
        Block("Efd", "field", "VR", ("KE", "TE", A, B)),
    ),
)
