"""REGFM_A1: an inverter that forms the grid by droops of frequency and voltage, an EMF behind RE + j XE.

    d angle/dt = omega_0 (MP (Pset - P) + overload of P),  Vcmd = Vset + MQ (Qset - Q) + overload of Q
    overload: min(0, KP (max - y) + integral of KI (max - y) <= 0) + max(0, the same of min)
    E = Vcmd (VFLAG 0), or a regulator KPV + KIV/s of Vcmd - V (VFLAG 1); within EMIN and EMAX

P, Q, V: the terminal's, seen with lags TPF, TQF, TVF. QVFLAG 1: Vset is found at the start, or comes from a plant
control, and Qset is 0; QVFLAG 0: Qset is, and Vset stays. Beyond IMAX (0: none) the current keeps its angle and the
droops run on. RE, XE: ZSORCE of the machine's data; TD, TE, TV: lags of the angle, of E, and of E once more (0 in the
library). Sources: Du et al., Model Specification of Droop-Controlled, Grid-Forming Inverters (REGFM_A1), PNNL-32278;
order of the record: GridPACK.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model, Source
from facts_damping.plant.machines.blocks import NO_LIMIT
from facts_damping_library.inverters.parts import overload, seen

ROW = Model(
    "inverter",
    "grid-forming inverter with droops",
    "VFLAG QVFLAG TPF TQF TVF IMAX EMAX EMIN PMAX PMIN QMAX QMIN MP MQ KPPMAX KIPMAX KPQMAX KIQMAX KPV KIV"
    " RE XE TD TE TV",
    (
        seen("P_seen", "Pe", "TPF"),
        seen("Q_seen", "Qe", "TQF"),
        seen("V_seen", "Vt", "TVF"),
        *overload("P", "KPPMAX", "KIPMAX"),
        *overload("Q", "KPQMAX", "KIQMAX"),
        Block("droop", "sum", "MP * Pref + MP * Paux - MP * P_seen"),
        Block("slip", "sum", "droop + P_above + P_below"),
        Block("angle_rate", "product", "omega_0 + slip"),
        Block("angle_order", "integral", "angle_rate", (1.0,)),
        Block("angle", "lag", "angle_order", (1.0, "TD")),
        Block("Vset", "sum", "Qext", when=lambda f: f.QVFLAG == 1),
        Block("Vset", "sum", "E0", when=lambda f: f.QVFLAG == 0 and f.VFLAG == 0),
        Block("Vset", "sum", "Vt0", when=lambda f: f.QVFLAG == 0 and f.VFLAG == 1),
        Block("Qset", "sum", "Qaux", when=lambda f: f.QVFLAG == 1),
        Block("Qset", "sum", "Qext + Qaux", when=lambda f: f.QVFLAG == 0),
        Block("V_droop", "sum", "Vset + Vaux + MQ * Qset - MQ * Q_seen"),
        Block("Vcmd", "sum", "V_droop + Q_above + Q_below"),
        Block("E_integral", "regulator", "Vcmd - V_seen", (0.0, "KIV"), "EMIN", "EMAX", when=lambda f: f.VFLAG == 1),
        Block("E_order", "sum", "KPV * Vcmd - KPV * V_seen + E_integral", when=lambda f: f.VFLAG == 1),
        Block("E_order", "sum", "Vcmd", when=lambda f: f.VFLAG == 0),
        Block("E_limited", "lag", "E_order", (1.0, "TE"), "EMIN", "EMAX"),
        Block("E", "lag", "E_limited", (1.0, "TV")),
    ),
    optional="RE TD TE TV",
    source=Source("voltage", "E", "none", ("RE", "XE", lambda f: f.IMAX or NO_LIMIT), "angle", forming=True),
)
