"""PSSSIM: GridPACK's stabiliser of speed (`psssim.cpp`): K s / (1 + s TW), then two lead-lag sections.

Both limits are those of MAXOUT, as there. The frequency of another area, which IC 1 adds there, is not modelled.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "stabiliser",
    "stabiliser of speed of GridPACK",
    "IC BUS1 BUS2 BUS3 BUS4 BUS5 BUS6 K TW T1 T2 T3 T4 MAXOUT MINOUT",
    (
        Block("washed", "rate", "omega", ("K", "TW")),
        Block("L1", "lead_lag", "washed", (1.0, "T1", "T2")),
        Block("L2", "lead_lag", "L1", (1.0, "T3", "T4")),
        Block("Vs", "sum", "L2", (), lambda f: -f.MAXOUT, "MAXOUT"),
    ),
    "BUS1 BUS2 BUS3 BUS4 BUS5 BUS6 MINOUT",
)
