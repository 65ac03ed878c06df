"""ST6B: IEEE type ST6B (Std 421.5-2005), a static exciter with a PID regulator and an inner loop of the field voltage.

VR = KFF VA + KM (VA - KG Efd / (1 + s TG)), at most KLR (KCI ILR - Ifd), but not below VRMIN; Efd = VR Vt. The limit is
written as (VR / KLR + Ifd) / KCI < ILR; KLR 0: none. No overexcitation limiter acts, whatever OEL is.
"""

from __future__ import annotations

from typing import Any

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import VOLTAGE_SEEN


def _current(f: Any) -> float:
    """1 / KCI where there is a limit, else 0."""
    return 1.0 / f.KCI if f.KLR > 0.0 and f.KCI > 0.0 else 0.0


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
        Block("forward", "sum", "FORWARD * VA - KM * VG", (), "VRMIN", "VRMAX"),
        Block("current", "sum", "SHARE * forward + CURRENT * Ifd", (), None, "ILR"),
        Block("VR", "sum", "FREE * forward + LIMITED * current - SLOPE * Ifd", (), "VRMIN"),
        Block("Efd", "product", "VR + Vt"),
    ),
    "OEL",
    {
        "FORWARD": lambda f: f.KFF + f.KM,
        "SHARE": lambda f: _current(f) / (f.KLR or 1.0),
        "CURRENT": _current,
        "FREE": lambda f: float(_current(f) == 0.0),
        "LIMITED": lambda f: max(0.0, f.KLR * f.KCI),
        "SLOPE": lambda f: f.KLR * f.KCI * _current(f),
    },
)
