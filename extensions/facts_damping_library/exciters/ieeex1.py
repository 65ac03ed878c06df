"""IEEEX1: IEEE type DC1A (Std 421.5-1992), a rotating DC exciter; KE and VRMAX of 0 as in PSS/E (`dc_exciter`)."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model
from facts_damping_library.parts import DC_FIELDS, dc_exciter

ROW = Model("exciter", "IEEE type 1 of 1979 (DC1A), a rotating DC exciter", DC_FIELDS, dc_exciter("one"), "SWITCH")
