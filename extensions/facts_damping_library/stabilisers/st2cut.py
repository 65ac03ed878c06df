"""ST2CUT: a stabiliser of two inputs of PSS/E; VCU and VCL as for IEEEST."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import pss_output

ROW = Model(
    "stabiliser",
    "stabiliser of two inputs",
    "IC IB IC2 IB2 K1 K2 T1 T2 T3 T4 T5 T6 T7 T8 T9 T10 LSMAX LSMIN VCU VCL",
    (
        Block("in_1", "lag", "input", ("K1", "T1")),
        Block("in_2", "lag", "input_2", ("K2", "T2")),
        Block("washed", "washout", "in_1 + in_2", (lambda f: f.T3 / f.T4 if f.T4 > 0 else 1.0, "T4")),
        Block("L1", "lead_lag", "washed", (1.0, "T5", "T6")),
        Block("L2", "lead_lag", "L1", (1.0, "T7", "T8")),
        Block("L3", "lead_lag", "L2", (1.0, "T9", "T10")),
        Block("limited", "sum", "L3", (), "LSMIN", "LSMAX"),
        pss_output("limited"),
    ),
    "IB IB2",
    optional="VCU VCL",
)
