"""REGFM_B1 (REGFMB1U): an inverter that forms the grid as a virtual synchronous machine, an EMF behind Re + j Xe.

    2 H d slip/dt = Pset - P - D1 slip - D2 s/(s + wD) slip - 1/mp 1/(1 + s Tp) (slip, or the PLL's: wFlag 1)
    d angle_IT/dt = omega_0 (slip - slip of the PLL),  EMF at the angle of the PLL + angle_IT
    Vcmd = Vref + mq (Qref - Q), or Vref - mq times the reactive current (VdrpFlag 1)
    E = (Kpv + Kiv/s) (Vcmd - V)

The steady current stays within ImaxSS, of which Idmax or Iqmax (PQFlag 0: of Q) is Kf times that, and the other what
is left: E is limited to |V +- Xe Iqmax + j Xe Id|; angle_IT to angle_max and angle_min, that integrate Ki (Idmax - Id)
and Ki (-Ke Idmax - Id) between 0 and +-asin(Xe ImaxSS); angle_min is 0 with ESFlag 0. States stand at these limits.
Beyond ImaxF the current keeps its angle. Below VPLLfrz the PLL stands. QVFlag as in REGFM_A1 (0: VdrpFlag counts as
0). FFlag 0: no droop of frequency. Re, Xe: ZSORCE of the machine's data. Sources: Du et al., Virtual Synchronous
Machine Grid-Forming Inverter Model Specification (REGFM_B1), NREL/TP-5D00-90260; order of the record: UNIFI's cases.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model, Source
from facts_damping_library.sources import seen

if TYPE_CHECKING:
    from collections.abc import Callable

STEADY: Callable[[Any], float] = lambda f: f.ImaxSS if f.ImaxSS > 0.0 else 1.0 / f.Xe  # noqa: E731
PRIORITY: Callable[[Any], float] = lambda f: (f.Kf or 1.0) * STEADY(f)  # noqa: E731
WIDEST: Callable[[Any], float] = lambda f: math.asin(min(1.0, f.Xe * STEADY(f)))  # noqa: E731

MACHINE = (
    Block("droop", "lag", "slip", (lambda f: -1.0 / f.mp, "Tp"), when=lambda f: f.FFlag == 1 and f.wFlag != 1),
    Block("droop", "lag", "pll_slip", (lambda f: -1.0 / f.mp, "Tp"), when=lambda f: f.FFlag == 1 and f.wFlag == 1),
    Block("droop", "sum", "none", when=lambda f: f.FFlag != 1),
    Block("damping", "washout", "slip", ("D2", lambda f: 1.0 / f.wD)),
    Block("power", "sum", "Pref + Paux + droop - P_seen"),
    Block("torque", "sum", "power - D1 * slip - damping"),
    Block("slip", "integral", "torque", (lambda f: 0.5 / f.H,), "Dwmin", "Dwmax"),
)
PLL = (
    Block("running", "window", "Vt + none + one", (-math.inf, "VPLLfrz")),
    Block("standing", "sum", "one - running"),
    Block("pll_order", "pi", "Vq", ("KpPLL", "KiPLL"), "DwPLLmin", "DwPLLmax", hold="standing"),
    Block("pll_slip", "product", "pll_order + running"),
    Block("pll_rate", "product", "omega_0 + pll_slip"),
    Block("angle", "integral", "pll_rate", (1.0,)),
)
CURRENT = (
    Block("Idmax", "sum", "PRIORITY * one", when=lambda f: f.PQFlag == 1),
    Block("Iqmax", "room", "Id_seen", (STEADY,), when=lambda f: f.PQFlag == 1),
    Block("Iqmax", "sum", "PRIORITY * one", when=lambda f: f.PQFlag != 1),
    Block("Idmax", "room", "Iq_seen", (STEADY,), when=lambda f: f.PQFlag != 1),
    Block("Id_left", "sum", "Idmax - Id_seen"),
    Block("Id_at_start", "sum", "Id_left", (), 0.0),  # a dispatch beyond it is told
    Block("angle_less", "stop", "Id_left", ("Ki",), lambda f: -WIDEST(f), 0.0),
    Block("angle_max", "sum", "WIDEST * one + angle_less"),
    Block("Id_back", "sum", "none - Ke * Idmax - Id_seen"),
    Block("angle_more", "stop", "Id_back", ("Ki",), 0.0, WIDEST, when=lambda f: f.ESFlag == 1),
    Block("angle_min", "sum", "angle_more - WIDEST * one", when=lambda f: f.ESFlag == 1),
    Block("angle_min", "sum", "none", when=lambda f: f.ESFlag != 1),
    Block("XId", "sum", "Xe * Id_seen"),
    Block("V_high", "sum", "V_seen + Xe * Iqmax"),
    Block("V_low", "sum", "V_seen - Xe * Iqmax"),
    Block("E_max", "magnitude", "V_high + XId"),
    Block("E_min", "magnitude", "V_low + XId"),
)

ROW = Model(
    "inverter",
    "grid-forming inverter as a virtual synchronous machine",
    "wFlag VdrpFlag QVFlag PQFlag FFlag ESFlag mq Kpv Kiv mp Dwmax Dwmin KpPLL KiPLL DwPLLmax DwPLLmin Tp H D1 D2 wD"
    " ImaxSS Kf Ki ImaxF Tpf Tqf Tvf Tif Ke VPLLfrz Re Xe",
    (
        seen("P_seen", "Pe", "Tpf"),
        seen("Q_seen", "Qe", "Tqf"),
        seen("V_seen", "Vt", "Tvf"),
        seen("Id_seen", "Id", "Tif"),
        seen("Iq_seen", "Iq", "Tif"),
        *MACHINE,
        *PLL,
        *CURRENT,
        Block("Vset", "sum", "Qext", when=lambda f: f.QVFlag == 1),
        Block("Vset", "sum", "Vt0 + mq * Qext", when=lambda f: f.QVFlag != 1),
        Block("V_droop", "sum", "mq * Iq_seen", when=lambda f: f.QVFlag == 1 and f.VdrpFlag == 1),
        Block("V_droop", "sum", "none - mq * Q_seen", when=lambda f: f.QVFlag != 1 or f.VdrpFlag != 1),
        Block("Vcmd", "sum", "Vset + Vaux + mq * Qaux + V_droop"),
        Block("E", "regulator", "Vcmd - V_seen", ("Kpv", "Kiv"), 1.0, 1.0, "E_min", "E_max"),
        Block("angle_rate", "sum", "slip - pll_slip"),
        Block("angle_change", "product", "omega_0 + angle_rate"),
        Block("angle_IT", "integral", "angle_change", (1.0,), 1.0, 1.0, "angle_min", "angle_max"),
        Block("cosine_IT", "cosine", "angle_IT"),
        Block("sine_IT", "sine", "angle_IT"),
        Block("Ed", "product", "E + cosine_IT"),
        Block("Eq", "product", "E + sine_IT"),
    ),
    factors={"PRIORITY": PRIORITY, "WIDEST": WIDEST},
    optional="Re",
    source=Source("voltage", "Ed", "Eq", ("Re", "Xe", "ImaxF"), "angle", virtual=True),
)
