"""ESDC2A."""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model
from facts_damping_library.parts import DC_FIELDS, dc_exciter

ROW = Model("exciter", "IEEE type DC2A of 1992, limits follow the voltage", DC_FIELDS, dc_exciter("Vt"), "SWITCH")
