"""PSS2A: IEEE type PSS2A (Std 421.5-1992), the integral of accelerating power from two inputs.

A washout, lag or lead-lag whose time constant is 0 is left out; without M or N there is no ramp-tracking filter.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import OTHER_INPUTS, two_inputs

ROW = Model(
    "stabiliser",
    "IEEE stabiliser of two inputs, integral of accelerating power",
    "IC IB IC2 IB2 M N TW1 TW2 T6 TW3 TW4 T7 KS2 KS3 T8 T9 KS1 T1 T2 T3 T4 VSTMAX VSTMIN",
    (*two_inputs("T1/T2 T3/T4"), Block("Vs", "sum", "L2", (), "VSTMIN", "VSTMAX")),
    "IB IB2",
    approximations=OTHER_INPUTS,
)
