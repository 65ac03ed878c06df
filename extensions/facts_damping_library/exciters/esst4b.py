"""ESST4B: IEEE type ST4B (Std 421.5-2005), a static exciter fed by voltage and current, two PI regulators.

VM = KPM (VR - KG Efd) + the integral, and Efd = VB VM, so VM = (KPM VR + integral) / (1 + KPM KG VB). No limiters of
over- and underexcitation act.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import COMPOUND_SOURCE, VOLTAGE_SEEN

ROW = Model(
    "exciter",
    "IEEE type ST4B of 2005, a static exciter fed by voltage and current",
    "TR KPR KIR VRMAX VRMIN TA KPM KIM VMMAX VMMIN KG KP KI VBMAX KC XL THETAP",
    (
        VOLTAGE_SEEN,
        Block("VPI", "pi", "Vref + Vs - VT", ("KPR", "KIR"), "VRMIN", "VRMAX"),
        Block("VR", "lag", "VPI", (1.0, "TA")),
        *COMPOUND_SOURCE,
        Block("integral", "integral", "VR - KG * Efd", ("KIM",), "VMMIN", "VMMAX"),
        Block("open", "sum", "KPM * VR + integral"),
        Block("loop", "sum", "one + LOOP * VB"),
        Block("VM", "quotient", "open + loop", (), "VMMIN", "VMMAX"),
        Block("Efd", "product", "VB + VM"),
    ),
    factors={"LOOP": lambda f: f.KPM * f.KG},
)
