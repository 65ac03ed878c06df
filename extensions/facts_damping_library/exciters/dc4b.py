"""DC4B."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import EXPONENTIAL_A, EXPONENTIAL_B, VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type DC4B of 2005, a rotating DC exciter with a PID regulator",
    "TR KP KI KD TD KA TA VRMAX VRMIN KE TE KF TF E1 SE1 E2 SE2",
    (
        VOLTAGE_SEEN,
        Block("VF", "rate", "Efd", ("KF", "TF")),
        Block("error", "sum", "Vref + Vs - VT - VF"),
        Block("integral", "integral", "error", ("KI",), lambda f: f.VRMIN / f.KA, lambda f: f.VRMAX / f.KA),
        Block("rate", "rate", "error", ("KD", "TD")),
        Block("PID", "sum", "KP * error + integral + rate", (), lambda f: f.VRMIN / f.KA, lambda f: f.VRMAX / f.KA),
        Block("VR", "lag", "PID", ("KA", "TA"), "VRMIN", "VRMAX"),
        Block("Efd", "exponential", "VR", ("KE", "TE", EXPONENTIAL_A, EXPONENTIAL_B)),
    ),
    record=False,
)
