"""REGFM_A1: an inverter that forms the grid by droops of frequency and voltage, an EMF behind Re + j Xe.

    d angle/dt = omega_0 (mp (Pset - P) + overload of P),  Vcmd = Vset + mq (Qset - Q) + overload of Q
    overload: min(0, KP (max - y) + integral of Ki (max - y) <= 0) + max(0, the same of min)
    E = Vcmd (VFlag 0), or a regulator Kpv + Kiv/s of Vcmd - V (VFlag 1); within Emin and Emax

P, Q, V: the terminal's, seen with lags Tpf, Tqf, Tvf. QVFlag 1: Vset is that of the start, or what a plant control
wants, and Qset is 0; QVFlag 0: this holds for Qset, and Vset stays that of the start. Beyond Imax (0: none) the
current keeps its angle and the droops run on. Re, Xe: ZSORCE of the machine's data; Td, Te, Tv: lags of the angle, of
E, and of E once more (0 in the library). Sources: Du et al., Model Specification of Droop-Controlled, Grid-Forming
Inverters (REGFM_A1), PNNL-32278; order of the record: GridPACK.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model, Source
from facts_damping.plant.machines.blocks import NO_LIMIT
from facts_damping_library.sources import overload, seen

ROW = Model(
    "inverter",
    "grid-forming inverter with droops",
    "VFlag QVFlag Tpf Tqf Tvf Imax Emax Emin Pmax Pmin Qmax Qmin mp mq Kppmax Kipmax Kpqmax Kiqmax Kpv Kiv"
    " Re Xe Td Te Tv",
    (
        seen("P_seen", "Pe", "Tpf"),
        seen("Q_seen", "Qe", "Tqf"),
        seen("V_seen", "Vt", "Tvf"),
        *overload("P", "Kppmax", "Kipmax"),
        *overload("Q", "Kpqmax", "Kiqmax"),
        Block("droop", "sum", "mp * Pref + mp * Paux - mp * P_seen"),
        Block("slip", "sum", "droop + P_above + P_below"),
        Block("angle_rate", "product", "omega_0 + slip"),
        Block("angle_order", "integral", "angle_rate", (1.0,)),
        Block("angle", "lag", "angle_order", (1.0, "Td")),
        Block("Vset", "sum", "Qext", when=lambda f: f.QVFlag == 1),
        Block("Vset", "sum", "E0", when=lambda f: f.QVFlag != 1 and f.VFlag != 1),
        Block("Vset", "sum", "Vt0", when=lambda f: f.QVFlag != 1 and f.VFlag == 1),
        Block("Qset", "sum", "Qaux", when=lambda f: f.QVFlag == 1),
        Block("Qset", "sum", "Qext + Qaux", when=lambda f: f.QVFlag != 1),
        Block("V_droop", "sum", "Vset + Vaux + mq * Qset - mq * Q_seen"),
        Block("Vcmd", "sum", "V_droop + Q_above + Q_below"),
        Block("E_integral", "regulator", "Vcmd - V_seen", (0.0, "Kiv"), "Emin", "Emax", when=lambda f: f.VFlag == 1),
        Block("E_order", "sum", "Kpv * Vcmd - Kpv * V_seen + E_integral", when=lambda f: f.VFlag == 1),
        Block("E_order", "sum", "Vcmd", when=lambda f: f.VFlag != 1),
        Block("E_limited", "lag", "E_order", (1.0, "Te"), "Emin", "Emax"),
        Block("E", "lag", "E_limited", (1.0, "Tv")),
    ),
    optional="Re Td Te Tv",
    source=Source("voltage", "E", "none", ("Re", "Xe", lambda f: f.Imax or NO_LIMIT), "angle", forming=True),
)
