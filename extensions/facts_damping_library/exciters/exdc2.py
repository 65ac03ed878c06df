"""EXDC2."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.parts import DC_FIELDS, dc_exciter

ROW = Model(
    "exciter",
    "IEEE type DC2 of 1981: limits follow the voltage, the field voltage the speed",
    DC_FIELDS,
    (*dc_exciter("Vt", "VX"), Block("speed", "sum", "one + omega"), Block("Efd", "product", "VX + speed")),
    "SWITCH",
)
