"""WSIEG1.

As IEEEG1, but a dead band takes DB1 from the size of the speed, and the steam is on the line through (GV1, PGV1) to
(GV5, PGV5), which goes on straight; points that are not to the right of those before do not count, and with fewer than
two the steam is the valve's position. Not modelled: a step or hysteresis of the dead band (ERR), play of the valve
(DB2), a blocked valve (IBLOCK). Source: PSS/E Model Library.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model
from facts_damping_library.turbines import ONE_SHAFT, STEAM_FACTORS, steam_turbine

POINTS = "GV1 PGV1 GV2 PGV2 GV3 PGV3 GV4 PGV4 GV5 PGV5"

ROW = Model(
    "governor",
    "steam turbine of IEEE type 1 as the WECC modified it; all its power acts on one shaft",
    f"JBUS JM K T1 T2 T3 UO UC PMAX PMIN T4 K1 K2 T5 K3 K4 T6 K5 K6 T7 K7 K8 DB1 ERR DB2 {POINTS} IBLOCK",
    (
        Block("band", "sum", "omega", (), lambda f: -f.DB1, "DB1"),
        Block("speed", "lead_lag", "omega - band", ("K", "T2", "T1")),
        Block("valve", "servo", "Pref - speed", ("T3", "UC", "UO"), "PMIN", "PMAX"),
        Block("steam", "curve", "valve", tuple(POINTS.split())),
        *steam_turbine("steam"),
    ),
    "JM ERR DB2 IBLOCK",
    STEAM_FACTORS,
    optional=f"JBUS K6 T7 K7 K8 DB1 ERR DB2 {POINTS} IBLOCK",
    approximations={
        **ONE_SHAFT,
        "its dead band has no step and no hysteresis ERR": lambda f: f.ERR != 0.0,
        "its valve has no play DB2": lambda f: f.DB2 != 0.0,
        "its valve is not blocked as IBLOCK says": lambda f: f.IBLOCK != 0.0,
    },
)
