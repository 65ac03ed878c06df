"""REECB1: WECC's REEC_B, the electrical control of solar plants.

It is REEC_A without tables, without speed, and without holds after a dip: the support Iqv of the voltage always acts.
`Paux` is added to the power reference, `Qaux` to the reactive power that is wanted, `Vaux` to the reference of the
voltage regulator (QFLAG 1). Vref0 of 0 is the voltage at the start. It sees the inverter's terminals.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.electrical import FACTORS, SUPPORT, commands, limits, measured, reactive

ROW = Model(
    "inverter_control",
    "WECC type REEC_B, an electrical control",
    "BUSR PFFLAG VFLAG QFLAG PQFLAG Vdip Vup Trv dbd1 dbd2 Kqv Iqh1 Iql1 Vref0 Tp Qmax Qmin Vmax Vmin Kqp Kqi Kvp Kvi "
    "Tiq dPmax dPmin Pmax Pmin Imax Tpord",
    (
        *measured(),
        *SUPPORT,
        *reactive(bias=""),
        Block("Pord", "servo", "Pref + Paux", ("Tpord", "dPmin", "dPmax"), "Pmin", "Pmax", hold="dip"),
        Block("Ip_order", "quotient", "Pord + V_divisor"),
        Block("VDLq", "sum", "Imax * one"),
        Block("VDLp", "sum", "Imax * one"),
        *limits(),
        *commands("Iq_order + Iqv"),
    ),
    "BUSR",
    FACTORS,
)
