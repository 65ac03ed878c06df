"""IEEET1: IEEE type 1 (Committee Report of 1968), a rotating DC exciter, without a lead-lag; KE of 0 as for IEEEX1."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN, A, B

ROW = Model(
    "exciter",
    "IEEE type 1 of 1968, a rotating DC exciter",
    "TR KA TA VRMAX VRMIN KE TE KF TF SWITCH E1 SE1 E2 SE2",
    (
        VOLTAGE_SEEN,
        Block("VF", "rate", "Efd", ("KF", "TF")),
        Block("VR", "lag", "Vref + Vs - VT - VF", ("KA", "TA"), "VRMIN", "VRMAX"),
        Block("Efd", "field", "VR", ("KE", "TE", A, B)),
    ),
    "SWITCH",
)
