"""ST6B: IEEE type ST6B (Std 421.5-2005), a static exciter with a PID regulator and an inner loop of the field voltage.

VR = KFF VA + KM (VA - KG Efd / (1 + s TG)), at most KLR (KCI ILR - Ifd), but not below VRMIN; Efd = VR Vt. No
overexcitation limiter acts, whatever OEL is.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST6B of 2005, a static exciter with an inner loop of the field voltage",
    "OEL TR KPA KIA KDA TDA VAMAX VAMIN KFF KM KCI KLR ILR VRMAX VRMIN KG TG",
    (
        VOLTAGE_SEEN,
        Block("error", "sum", "Vref + Vs - VT"),
        Block("rate", "rate", "error", ("KDA", "TDA")),
        Block("integral", "pi", "error", ("KPA", "KIA"), "VAMIN", "VAMAX"),
        Block("VA", "sum", "integral + rate", (), "VAMIN", "VAMAX"),
        Block("VG", "lag", "Efd", ("KG", "TG")),
        Block("VL", "limiter", "ALLOWED * one - KLR * Ifd", (), "VRMIN"),
        Block("forward", "sum", "FORWARD * VA - KM * VG", (), "VRMIN", "VRMAX"),
        Block("VR", "sum", "forward", (), None, 1.0, "one", "VL"),
        Block("Efd", "product", "VR + Vt"),
    ),
    "OEL",
    {"ALLOWED": lambda f: f.KLR * f.KCI * f.ILR, "FORWARD": lambda f: f.KFF + f.KM},
)
