"""WTDTA1.

Turbine and generator are masses on a shaft that twists and damps; without Htfrac or Freq1 they are one mass. Freq1 (Hz)
is that of the shaft: with inertias Ht = Htfrac H and Hg = H - Ht its stiffness is 2 Ht Hg / H (2 pi Freq1)^2 p.u. of
torque per p.u. of speed and s. DAMP brakes the generator by its deviation from the speed at the start, which is 1 where
no torque control gives it. Without aerodynamics the mechanical power is that at the start. Sources: PSS/E Model
Library; WECC, Second Generation Wind Turbine Models, 2014 (WTGT_A).
"""

from __future__ import annotations

from math import pi
from typing import TYPE_CHECKING, Any

from facts_damping.machine_controls.blocks import Block, Model

if TYPE_CHECKING:
    from collections.abc import Callable

TWO: Callable[[Any], bool] = lambda f: 0.0 < f.Htfrac < 1.0 and f.Freq1 > 0.0  # noqa: E731 (beside its counterpart)
ONE: Callable[[Any], bool] = lambda f: not TWO(f)  # noqa: E731

ROW = Model(
    "inverter_control",
    "drive train of a wind turbine",
    "H DAMP Htfrac Freq1 Dshaft",
    (
        Block("torque", "quotient", "Pm + speed_turbine"),
        Block("braking", "quotient", "Pe + speed"),
        Block("speed_start", "regulator", "none", (0.0, 0.0), when=lambda f: f.DAMP != 0.0),
        Block("friction", "sum", "DAMP * speed - DAMP * speed_start", when=lambda f: f.DAMP != 0.0),
        Block("friction", "sum", "none", when=lambda f: f.DAMP == 0.0),
        Block(
            *("twist", "integral", "speed_turbine - speed"),
            (lambda f: 2.0 * f.Htfrac * (1.0 - f.Htfrac) * f.H * (2.0 * pi * f.Freq1) ** 2,),
            when=TWO,
        ),
        Block("shaft", "sum", "twist + Dshaft * speed_turbine - Dshaft * speed", when=TWO),
        Block("speed_turbine", "integral", "torque - shaft", (lambda f: 0.5 / (f.Htfrac * f.H),), when=TWO, start=1.0),
        Block(
            *("speed", "integral", "shaft - braking - friction"),
            (lambda f: 0.5 / ((1.0 - f.Htfrac) * f.H),),
            when=TWO,
            start=1.0,
        ),
        Block("speed_turbine", "sum", "speed", when=ONE),
        Block("speed", "integral", "torque - braking - friction", (lambda f: 0.5 / f.H,), when=ONE, start=1.0),
    ),
)
