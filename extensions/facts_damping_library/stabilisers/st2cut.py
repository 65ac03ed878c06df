"""ST2CUT: a stabiliser of two inputs of PSS/E.

With T3 = 0 the washout is a lag. The output is zero while the terminal voltage is further than VCU above that of the
start, or below it by more than -VCL; 0: no such bound.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import OTHER_INPUTS, pss_output

ROW = Model(
    "stabiliser",
    "stabiliser of two inputs",
    "IC IB IC2 IB2 K1 K2 T1 T2 T3 T4 T5 T6 T7 T8 T9 T10 LSMAX LSMIN VCU VCL",
    (
        Block("in_1", "lag", "input", ("K1", "T1")),
        Block("in_2", "lag", "input_2", ("K2", "T2")),
        Block("washed", "washout", "in_1 + in_2", (lambda f: f.T3 / f.T4 if f.T4 > 0 else 1.0, "T4")),
        Block("lagging", "lag", "in_1 + in_2", (lambda f: float(f.T3 == 0.0 < f.T4), lambda f: 0.0 if f.T3 else f.T4)),
        Block("L1", "lead_lag", "washed + lagging", (1.0, "T5", "T6")),
        Block("L2", "lead_lag", "L1", (1.0, "T7", "T8")),
        Block("L3", "lead_lag", "L2", (1.0, "T9", "T10")),
        Block("limited", "sum", "L3", (), "LSMIN", "LSMAX"),
        Block("change", "sum", "Vt - Vt0"),
        pss_output("limited", "change"),
    ),
    "IB IB2",
    optional="VCU VCL",
    approximations=OTHER_INPUTS,
)
