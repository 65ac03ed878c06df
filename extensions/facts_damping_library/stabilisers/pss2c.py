"""PSS2C: IEEE type PSS2C (Std 421.5-2016), PSS2B with a fourth lead-lag section and a switch of the output by power.

It is switched on where the power of the machine reaches PSSON, off where it falls to PSSOFF, and stays as it is between
them, at the start on; PSSON below 0: always on. The output follows within `SWITCHING`. The compensated frequency (input
7; XCOMP, TCOMP) is not modelled.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import SHORTEST, Block, Model
from facts_damping_library.parts import OTHER_INPUTS, two_inputs
from facts_damping_library.stabilisers import pss2b

SWITCHING = SHORTEST

ROW = Model(
    "stabiliser",
    "IEEE stabiliser of two inputs of 2016, switched by power",
    f"{pss2b.ROW.fields} T12 T13 PSSON PSSOFF XCOMP TCOMP",
    (
        *two_inputs("T1/T2 T3/T4 T10/T11 T12/T13", limited=True),
        Block("limited", "sum", "L4", (), "VSTMIN", "VSTMAX"),
        Block("on", "relay", "Pe", ("PSSOFF", "PSSON", SWITCHING)),
        Block("Vs", "product", "limited + on"),
    ),
    "IB IB2 XCOMP TCOMP",
    approximations=OTHER_INPUTS,
)
