"""REECA1: WECC's REEC_A, the electrical control of wind and solar plants.

In a dip (Vt below Vdip or above Vup) a reactive current Iqv is added, and after it for |Thld| s, too (Thld below 0),
or Iqfrz instead (Thld above 0); the limit of the active current stays for Thld2 s as it was at the end of the dip.
Where that ends it follows within 2 ms. With PFFLAG 1 the power factor is that of the start. `Paux` is added to the
power reference, `Qaux` to the reactive power that is wanted, `Vaux` to the reference of the voltage regulator
(QFLAG 1). Vref0 of 0 is the voltage at the start. It sees the inverter's terminals.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import SHORTEST, Block, Model
from facts_damping_library.electrical import FACTORS, SUPPORT, active, commands, limits, measured, reactive, table

ROW = Model(
    "inverter_control",
    "WECC type REEC_A, an electrical control with tables of current limits",
    "BUSR PFFLAG VFLAG QFLAG PFLAG PQFLAG Vdip Vup Trv dbd1 dbd2 Kqv Iqh1 Iql1 Vref0 Iqfrz Thld Thld2 Tp Qmax Qmin "
    "Vmax Vmin Kqp Kqi Kvp Kvi Vbias Tiq dPmax dPmin Pmax Pmin Imax Tpord "
    "Vq1 Iq1 Vq2 Iq2 Vq3 Iq3 Vq4 Iq4 Vp1 Ip1 Vp2 Ip2 Vp3 Ip3 Vp4 Ip4",
    (
        *measured(),
        *SUPPORT,
        Block("supported", "after", "dip", (lambda f: abs(f.Thld),), start=0.0),
        Block("in_support", "product", "supported + Iqv", when=lambda f: f.Thld <= 0.0),
        Block("in_support", "product", "dip + Iqv", when=lambda f: f.Thld > 0.0),
        Block("Iqinj", "sum", "in_support", when=lambda f: f.Thld <= 0.0),
        Block("Iqinj", "sum", "in_support + Iqfrz * supported - Iqfrz * dip", when=lambda f: f.Thld > 0.0),
        *reactive(),
        *active("Pref + Paux"),
        Block("Ip_order", "quotient", "Pord + V_divisor"),
        *table("q", 4),
        *table("p", 4),
        *limits(ip="Ip_limit"),
        Block("recovering", "after", "dip", ("Thld2",), start=0.0),
        Block("limit_held", "sum", "recovering - dip"),
        Block("Ipmax", "lag", "Ip_limit", (1.0, SHORTEST), hold="limit_held", when=lambda f: f.Thld2 > 0.0),
        Block("Ipmax", "sum", "Ip_limit", when=lambda f: f.Thld2 == 0.0),
        *commands("Iq_order + Iqinj"),
    ),
    "BUSR",
    FACTORS,
)
