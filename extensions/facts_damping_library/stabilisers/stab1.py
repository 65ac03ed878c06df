"""STAB1: a stabiliser of speed of PSS/E: KT T s / (1 + T s), then two lead-lag sections.

KT is gain over T; T1T3 and T2T4 are numerators over the denominators T3 and T4.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "stabiliser",
    "stabiliser of speed",
    "KT T T1T3 T3 T2T4 T4 HLIM",
    (
        Block("washed", "washout", "omega", ("KT", "T")),
        Block("L1", "lead_lag", "washed", (1.0, lambda f: f.T1T3 * f.T3, "T3")),
        Block("L2", "lead_lag", "L1", (1.0, lambda f: f.T2T4 * f.T4, "T4")),
        Block("Vs", "sum", "L2", (), lambda f: -f.HLIM, "HLIM"),
    ),
)
