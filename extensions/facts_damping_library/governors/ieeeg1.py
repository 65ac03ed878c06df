"""IEEEG1.

Source: IEEE Committee Report, Dynamic Models for Steam and Hydro Turbines in Power System Studies, 1973.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.turbines import ONE_SHAFT, STEAM_FACTORS, steam_turbine

ROW = Model(
    "governor",
    "steam turbine of IEEE type 1; all its power acts on one shaft",
    "JBUS JM K T1 T2 T3 UO UC PMAX PMIN T4 K1 K2 T5 K3 K4 T6 K5 K6 T7 K7 K8",
    (
        Block("speed", "lead_lag", "omega", ("K", "T2", "T1")),
        Block("valve", "servo", "Pref - speed", ("T3", "UC", "UO"), "PMIN", "PMAX"),
        *steam_turbine("valve"),
    ),
    "JM",
    STEAM_FACTORS,
    optional="JBUS",
    approximations=ONE_SHAFT,
)
