"""ESDC1A: IEEE type DC1A (Std 421.5-1992), a rotating DC exciter; the equations of IEEEX1."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model
from facts_damping_library.parts import DC_FIELDS, dc_exciter

ROW = Model("exciter", "IEEE type DC1A of 1992, a rotating DC exciter", DC_FIELDS, dc_exciter("one"), "SWITCH")
