"""WTPTA1: the pitch control of a wind turbine, WECC's WTGPT_A.

Pitch (deg) follows the sum of two regulators: of the turbine's speed, to which Kcc times the power in excess is added,
and of the power in excess. Both stop at the limits of the pitch. The excess is that of the order of the electrical
control over the reference of the plant. At the start the second regulator gives 0.

Sources: PSS/E Model Library; WECC, Second Generation Wind Turbine Models, 2014.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

ROW = Model(
    "inverter_control",
    "pitch control of a wind turbine",
    "Kiw Kpw Kic Kpc Kcc Tp TetaMax TetaMin RTetaMax RTetaMin",
    (
        Block("excess", "sum", "Pord - Pext"),
        Block("overspeed", "sum", "speed_turbine - speed_reference + Kcc * excess"),
        # From the start, where the pitch is that of the aerodynamics, to its limits.
        Block("pitch_above", "sum", "TetaMax * one - pitch_start"),
        Block("pitch_below", "sum", "TetaMin * one - pitch_start"),
        Block(
            "pitch_of_speed",
            "pi",
            "overspeed",
            ("Kpw", "Kiw"),
            1.0,
            1.0,
            "pitch_below",
            "pitch_above",
            start=0.0,
        ),
        Block("pitch_of_power", "pi", "excess", ("Kpc", "Kic"), "TetaMin", "TetaMax", start=0.0),
        Block(
            "pitch_moved",
            "servo",
            "pitch_of_speed + pitch_of_power",
            ("Tp", "RTetaMin", "RTetaMax"),
            1.0,
            1.0,
            "pitch_below",
            "pitch_above",
            start=0.0,
        ),
        Block("pitch", "sum", "pitch_start + pitch_moved"),
    ),
)
