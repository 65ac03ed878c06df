"""REGFM_B1 (REGFMB1U): an inverter that forms the grid as a virtual synchronous machine, an EMF behind RE + j XE.

    2 H d slip/dt = Pset - P - D1 slip - D2 s/(s + wD) slip - 1/MP 1/(1 + s TP) (slip, or the PLL's: WFLAG 1)
    d angle_IT/dt = omega_0 (slip - slip of the PLL),  EMF at the angle of the PLL + angle_IT
    Vcmd = Vref + MQ (Qref - Q), or Vref - MQ times the reactive current (VDRPFLAG 1)
    E = (KPV + KIV/s) (Vcmd - V)

The steady current stays within IMAXSS, of which IDMAX or IQMAX (PQFLAG 0: of Q) is KF times that, and the other what
is left: E is limited to |V +- XE IQMAX + j XE Id|; angle_IT to angle_max and angle_min, that integrate KI (IDMAX - Id)
and KI (-KE IDMAX - Id) between 0 and +-asin(XE IMAXSS); angle_min is 0 with ESFLAG 0. States stand at these limits.
Beyond IMAXF the current keeps its angle. Below VPLLFRZ the PLL stands. QVFLAG as in REGFM_A1 (0: VDRPFLAG counts as
0). FFLAG 0: no droop of frequency. RE, XE: ZSORCE of the machine's data. Sources: Du et al., Virtual Synchronous
Machine Grid-Forming Inverter Model Specification (REGFM_B1), NREL/TP-5D00-90260; order of the record: UNIFI's cases.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model, Source
from facts_damping_library.inverters.parts import seen

if TYPE_CHECKING:
    from collections.abc import Callable

STEADY: Callable[[Any], float] = lambda f: f.IMAXSS if f.IMAXSS > 0.0 else 1.0 / f.XE  # noqa: E731
PRIORITY: Callable[[Any], float] = lambda f: (f.KF or 1.0) * STEADY(f)  # noqa: E731
WIDEST: Callable[[Any], float] = lambda f: math.asin(min(1.0, f.XE * STEADY(f)))  # noqa: E731

MACHINE = (
    Block("droop", "lag", "slip", (lambda f: -1.0 / f.MP, "TP"), when=lambda f: f.FFLAG == 1 and f.WFLAG == 0),
    Block("droop", "lag", "pll_slip", (lambda f: -1.0 / f.MP, "TP"), when=lambda f: f.FFLAG == 1 and f.WFLAG == 1),
    Block("droop", "sum", "none", when=lambda f: f.FFLAG == 0),
    Block("damping", "washout", "slip", ("D2", lambda f: 1.0 / f.WD)),
    Block("power", "sum", "Pref + Paux + droop - P_seen"),
    Block("torque", "sum", "power - D1 * slip - damping"),
    Block("slip", "integral", "torque", (lambda f: 0.5 / f.H,), "DWMIN", "DWMAX"),
)
PLL = (
    Block("running", "window", "Vt + none + one", (-math.inf, "VPLLFRZ")),
    Block("standing", "sum", "one - running"),
    Block("pll_order", "pi", "Vq", ("KPPLL", "KIPLL"), "DWPLLMIN", "DWPLLMAX", hold="standing"),
    Block("pll_slip", "product", "pll_order + running"),
    Block("pll_rate", "product", "omega_0 + pll_slip"),
    Block("angle", "integral", "pll_rate", (1.0,)),
)
CURRENT = (
    Block("IDMAX", "sum", "PRIORITY * one", when=lambda f: f.PQFLAG == 1),
    Block("IQMAX", "room", "Id_seen", (STEADY,), when=lambda f: f.PQFLAG == 1),
    Block("IQMAX", "sum", "PRIORITY * one", when=lambda f: f.PQFLAG == 0),
    Block("IDMAX", "room", "Iq_seen", (STEADY,), when=lambda f: f.PQFLAG == 0),
    Block("angle_max", "stop", "IDMAX - Id_seen", ("KI",), 0.0, WIDEST),
    Block(
        "angle_min",
        "stop",
        "none - KE * IDMAX - Id_seen",
        ("KI",),
        lambda f: -WIDEST(f),
        0.0,
        when=lambda f: f.ESFLAG == 1,
    ),
    Block("angle_min", "sum", "none", when=lambda f: f.ESFLAG == 0),
    Block("XId", "sum", "XE * Id_seen"),
    Block("V_high", "sum", "V_seen + XE * IQMAX"),
    Block("V_low", "sum", "V_seen - XE * IQMAX"),
    Block("E_max", "magnitude", "V_high + XId"),
    Block("E_min", "magnitude", "V_low + XId"),
)

ROW = Model(
    "inverter",
    "grid-forming inverter as a virtual synchronous machine",
    "WFLAG VDRPFLAG QVFLAG PQFLAG FFLAG ESFLAG MQ KPV KIV MP DWMAX DWMIN KPPLL KIPLL DWPLLMAX DWPLLMIN TP H D1 D2 WD"
    " IMAXSS KF KI IMAXF TPF TQF TVF TIF KE VPLLFRZ RE XE",
    (
        seen("P_seen", "Pe", "TPF"),
        seen("Q_seen", "Qe", "TQF"),
        seen("V_seen", "Vt", "TVF"),
        seen("Id_seen", "Id", "TIF"),
        seen("Iq_seen", "Iq", "TIF"),
        *MACHINE,
        *PLL,
        *CURRENT,
        Block("Vset", "sum", "Qext", when=lambda f: f.QVFLAG == 1),
        Block("Vset", "sum", "Vt0 + MQ * Qext", when=lambda f: f.QVFLAG == 0),
        Block("V_droop", "sum", "MQ * Iq_seen", when=lambda f: f.QVFLAG == 1 and f.VDRPFLAG == 1),
        Block("V_droop", "sum", "none - MQ * Q_seen", when=lambda f: f.QVFLAG == 0 or f.VDRPFLAG == 0),
        Block("Vcmd", "sum", "Vset + Vaux + MQ * Qaux + V_droop"),
        Block("E", "regulator", "Vcmd - V_seen", ("KPV", "KIV"), 1.0, 1.0, "E_min", "E_max"),
        Block("angle_rate", "sum", "slip - pll_slip"),
        Block("angle_change", "product", "omega_0 + angle_rate"),
        Block("angle_IT", "integral", "angle_change", (1.0,), 1.0, 1.0, "angle_min", "angle_max"),
        Block("cosine_IT", "cosine", "angle_IT"),
        Block("sine_IT", "sine", "angle_IT"),
        Block("Ed", "product", "E + cosine_IT"),
        Block("Eq", "product", "E + sine_IT"),
    ),
    factors={"PRIORITY": PRIORITY},
    optional="RE",
    source=Source("voltage", "Ed", "Eq", ("RE", "XE", "IMAXF"), "angle"),
)
