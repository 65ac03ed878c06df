"""ST8C: IEEE type ST8C (Std 421.5-2016), a static exciter with an inner loop of the field current.

Efd = VR VB1 + VB2,  VB1 = VE FEX(KC1 Ifd / VE) up to VB1MAX,  VB2 = KI2 |It| FEX(KC2 Ifd / (KI2 |It|)) up to VB2MAX.
SW1 1: VE = |KP Vt + j (KI1 + KP XL) It|, KP at the angle THETAP; 0: a constant source, VE = KP. Limiters of over- and
underexcitation and of the stator current do not act, whatever OEL, UEL and SCL are.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST8C of 2016, a static exciter with an inner loop of the field current",
    "OEL UEL SCL SW1 TR KPR KIR VPIMAX VPIMIN KPA KIA VAMAX VAMIN KA TA VRMAX VRMIN KF TF KC1 KP KI1 XL THETAP VB1MAX "
    "KC2 KI2 VB2MAX",
    (
        VOLTAGE_SEEN,
        Block("VPI", "pi", "Vref + Vs - VT", ("KPR", "KIR"), "VPIMIN", "VPIMAX"),
        Block("VF", "lag", "Ifd", ("KF", "TF")),
        Block("VA", "pi", "VPI - VF", ("KPA", "KIA"), "VAMIN", "VAMAX"),
        Block("VR", "lag", "VA", ("KA", "TA"), "VRMIN", "VRMAX"),
        Block("terminals", "source", "Vd + Vq + Id + Iq", ("KP", "THETAP", "KI1", "XL")),
        Block("VE", "sum", "FED * terminals + SOLID * one"),
        Block("rectified", "rectifier", "VE + Ifd", ("KC1",)),
        Block("VB1", "limiter", "rectified", (), None, "VB1MAX"),
        Block("stator", "source", "Vd + Vq + Id + Iq", (0.0, 0.0, "KI2", 0.0)),
        Block("rectified_2", "rectifier", "stator + Ifd", ("KC2",)),
        Block("VB2", "limiter", "rectified_2", (), None, "VB2MAX"),
        Block("boosted", "product", "VB1 + VR"),
        Block("Efd", "sum", "boosted + VB2"),
    ),
    "OEL UEL SCL",
    {"FED": lambda f: float(f.SW1 == 1.0), "SOLID": lambda f: f.KP * float(f.SW1 != 1.0)},
)
