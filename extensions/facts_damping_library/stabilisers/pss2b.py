"""PSS2B: IEEE type PSS2B (Std 421.5-2005), PSS2A with limits of both inputs and a third lead-lag section."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import OTHER_INPUTS, two_inputs

ROW = Model(
    "stabiliser",
    "IEEE stabiliser of two inputs of 2005",
    "IC IB IC2 IB2 M N TW1 TW2 T6 TW3 TW4 T7 KS2 KS3 T8 T9 KS1 T1 T2 T3 T4 T10 T11 VS1MAX VS1MIN VS2MAX VS2MIN VSTMAX "
    "VSTMIN",
    (*two_inputs("T1/T2 T3/T4 T10/T11", limited=True), Block("Vs", "sum", "L3", (), "VSTMIN", "VSTMAX")),
    "IB IB2",
    approximations=OTHER_INPUTS,
)
