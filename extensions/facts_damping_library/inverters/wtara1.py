"""WTARA1: the aerodynamics of a wind turbine, WECC's WTGAR_A.

Pm = Pm0 - Ka theta (theta - Theta0), with the pitch theta and the power Pm0 of the start, where theta is Theta0
(deg). Without a pitch control theta stays. Sources: PSS/E Model Library; WECC, Second Generation Wind Turbine Models,
2014.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "inverter_control",
    "aerodynamics of a wind turbine",
    "Ka Theta0",
    (
        Block("pitch_start", "sum", "Theta0 * one"),
        Block("pitched", "sum", "pitch - pitch_start"),
        Block("spilled", "product", "pitch + pitched"),
        Block("Pm", "sum", "Pe0 - Ka * spilled"),
    ),
)
