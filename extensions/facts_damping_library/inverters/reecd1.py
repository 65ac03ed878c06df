"""REECD1: WECC's REEC_D, the electrical control of wind, solar and battery plants.

Beside REEC_A: the voltage regulator controls the voltage behind a compensation, |V - (Rc + j Xc) I| (VCMPFLAG 1) or
V + Kc Q, through the lag Tr1; the support Iqv always acts; the least active current is -Ke times the greatest; below
Vblkl or above Vblkh of the voltage that is seen, and for Tblk s after it, there is no current at all. After a dip, of
the voltage that is seen, the reactive command stays |Thld| s as it was at its end (Thld above 0), or is Iqfrz (below
0); the active command and its limit stay Thld2 s. What is held follows within 2 ms while it is free. `Paux` is added
behind the lag Tpord, as in the specification; `Qaux` and `Vaux` act as in REEC_A.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import SHORTEST, Block, Model
from facts_damping_library.electrical import FACTORS, SUPPORT, active, commands, limits, measured, reactive, table

POINTS = 10
ROW = Model(
    "inverter_control",
    "WECC type REEC_D, an electrical control with tables of current limits, compensation and blocking",
    "PFFLAG VFLAG QFLAG PFLAG PQFLAG VCMPFLAG Vdip Vup Trv dbd1 dbd2 Kqv Iqh1 Iql1 Vref0 Iqfrz Thld Thld2 Tp Qmax Qmin "
    "Vmax Vmin Kqp Kqi Kvp Kvi Vbias Tiq dPmax dPmin Pmax Pmin Imax Tpord "
    + " ".join(f"V{sort}{i} I{sort}{i}" for sort in "qp" for i in range(1, POINTS + 1))
    + " Rc Xc Tr1 Kc Ke Vblkl Vblkh Tblk",
    (
        *measured("V_seen"),
        *SUPPORT,
        Block(
            "V_compensated",
            "source",
            "Vd + Vq + Id + Iq",
            (1.0, -90.0, "Rc", lambda f: -f.Xc),  # |V + j (Rc exp(j 90 deg) - Xc) I|
            when=lambda f: f.VCMPFLAG == 1.0,
        ),
        Block("V_compensated", "sum", "Vt + Kc * Qe", when=lambda f: f.VCMPFLAG != 1.0),
        Block("V_controlled", "lag", "V_compensated", (1.0, "Tr1")),
        *reactive("V_controlled"),
        *active("Pref"),
        Block("P_total", "sum", "Pord + Paux"),
        Block("Ip_total", "quotient", "P_total + V_divisor"),
        Block("recovering", "after", "dip", ("Thld2",), start=0.0),
        Block("p_held", "sum", "recovering - dip"),
        Block("Ip_order", "lag", "Ip_total", (1.0, SHORTEST), hold="p_held", when=lambda f: f.Thld2 > 0.0),
        Block("Ip_order", "sum", "Ip_total", when=lambda f: f.Thld2 == 0.0),
        Block("settling", "after", "dip", (lambda f: abs(f.Thld),), start=0.0),
        Block("q_held", "sum", "settling - dip"),
        Block("Iq_total", "sum", "Iq_order + Iqv"),
        Block("Iq_chosen", "lag", "Iq_total", (1.0, SHORTEST), hold="q_held", when=lambda f: f.Thld > 0.0),
        Block("Iq_chosen", "window", "q_held + Iq_total + Iqfrz * one", (-0.5, 0.5), when=lambda f: f.Thld <= 0.0),
        *table("q", POINTS),
        *table("p", POINTS),
        *limits("Iq_limit", "Ip_limit"),
        Block("Ip_most", "lag", "Ip_limit", (1.0, SHORTEST), hold="p_held", when=lambda f: f.Thld2 > 0.0),
        Block("Ip_most", "sum", "Ip_limit", when=lambda f: f.Thld2 == 0.0),
        Block("off", "window", "V_seen + none + one", ("Vblkl", "Vblkh")),
        Block("blocked", "after", "off", ("Tblk",), start=0.0),
        Block("Ipmax", "window", "blocked + Ip_most + none", (-0.5, 0.5)),
        Block("Iqmax", "window", "blocked + Iq_limit + none", (-0.5, 0.5)),
        *commands("Iq_chosen", lambda f: -f.Ke),
    ),
    "",
    FACTORS,
    optional=" ".join(f"V{sort}{i} I{sort}{i}" for sort in "qp" for i in range(3, POINTS + 1)),
)
