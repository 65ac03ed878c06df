"""WTTQA1: the torque control of a wind turbine, WECC's WTGTRQ_A.

Its speed reference follows the power on the line through (p1, spd1) to (p4, spd4), and stays beyond its ends. A
regulator of the torque sees the deviation of the generator's speed from it (Tflag 0), or the lack of power over the
speed (Tflag 1). It is held while the electrical control sees a dip of the voltage. Powers are p.u. of MBASE. Sources:
PSS/E Model Library; WECC, Second Generation Wind Turbine Models, 2014.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model

POINTS = "p1 spd1 p2 spd2 p3 spd3 p4 spd4"

ROW = Model(
    "inverter_control",
    "torque control of a wind turbine",
    f"Tflag Kpp KIP Tp Twref Temax Temin {POINTS} TRATE",
    (
        Block("power_seen", "lag", "Pe", (1.0, "Tp")),
        Block("speed_of_power", "curve", "power_seen", tuple(POINTS.split())),
        Block("speed_wanted", "limiter", "speed_of_power", (), "spd1", "spd4"),
        Block("speed_reference", "lag", "speed_wanted", (1.0, "Twref")),
        Block("lack", "sum", "Pext - power_seen", when=lambda f: f.Tflag == 1),
        Block("torque_error", "quotient", "lack + speed_generator", when=lambda f: f.Tflag == 1),
        Block("torque_error", "sum", "speed_generator - speed_reference", when=lambda f: f.Tflag != 1),
        Block("torque_order", "regulator", "torque_error", ("Kpp", "KIP"), "Temin", "Temax", hold="dip"),
        Block("Pref", "product", "torque_order + speed_generator"),
    ),
    "TRATE",
    optional="TRATE",
    approximations={"its powers are p.u. of MBASE, not of TRATE": lambda f: f.TRATE != 0.0},
)
