"""WTDTA1: the drive train of a wind turbine, WECC's WTGT_A.

Turbine and generator are masses on a shaft that twists and damps; without Htfrac or Freq1 they are one mass. Freq1 (Hz)
is that of the shaft: with inertias Ht = Htfrac H and Hg = H - Ht its stiffness is 2 Ht Hg / H (2 pi Freq1)^2 p.u. of
torque per p.u. of speed and s. DAMP brakes the generator by its deviation from the speed at the start, which is 1 where
no torque control gives it. Without aerodynamics the mechanical power is that at the start.

Sources: PSS/E Model Library; WECC, Second Generation Wind Turbine Models, 2014.
"""

from __future__ import annotations

from math import pi
from typing import Any

from facts_damping.machine_controls.blocks import Block, Model


def two_masses(f: Any) -> bool:
    """Whether the shaft twists."""
    return 0.0 < f.Htfrac < 1.0 and f.Freq1 > 0.0  # type: ignore[no-any-return]


def one_mass(f: Any) -> bool:
    """Whether it does not."""
    return not two_masses(f)


def stiffness(f: Any) -> float:
    """Of the shaft, p.u. of torque per p.u. of speed and s."""
    return float(2.0 * f.Htfrac * (1.0 - f.Htfrac) * f.H * (2.0 * pi * f.Freq1) ** 2)


ROW = Model(
    "inverter_control",
    "drive train of a wind turbine",
    "H DAMP Htfrac Freq1 Dshaft",
    (
        Block("speed_generator", "sum", "speed"),
        Block("torque", "quotient", "Pm + speed_turbine"),
        Block("braking", "quotient", "Pe + speed"),
        Block("speed_start", "regulator", "none", (0.0, 0.0), when=lambda f: f.DAMP != 0.0),
        Block("friction", "sum", "DAMP * speed - DAMP * speed_start", when=lambda f: f.DAMP != 0.0),
        Block("friction", "sum", "none", when=lambda f: f.DAMP == 0.0),
        Block("twist", "integral", "speed_turbine - speed", (stiffness,), when=two_masses),
        Block("shaft", "sum", "twist + Dshaft * speed_turbine - Dshaft * speed", when=two_masses),
        Block(
            "speed_turbine",
            "integral",
            "torque - shaft",
            (lambda f: 0.5 / (f.Htfrac * f.H),),
            when=two_masses,
            start=1.0,
        ),
        Block(
            "speed",
            "integral",
            "shaft - braking - friction",
            (lambda f: 0.5 / ((1.0 - f.Htfrac) * f.H),),
            when=two_masses,
            start=1.0,
        ),
        Block("speed_turbine", "sum", "speed", when=one_mass),
        Block("speed", "integral", "torque - braking - friction", (lambda f: 0.5 / f.H,), when=one_mass, start=1.0),
    ),
)
