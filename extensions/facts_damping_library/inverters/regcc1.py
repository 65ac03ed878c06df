"""REGC_C: as REGC_B, with a PLL and a controller of the current.

    i = (Kip + Kii/s) (Ip - j Iq - I),  E = V + (Re + j Xe) i, with a lag Te, at the PLL's angle
    d angle/dt = (Kppll + Kipll/s) Vq, within wmin and wmax, rad/s; Vq: across the PLL's direction

Sources: Ramasubramanian et al. (EPRI for WECC, 2021); equations and order of the record: GridPACK.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model, Source
from facts_damping.plant.machines.blocks import NO_LIMIT
from facts_damping_library.sources import limited_currents, source_voltage

ROW = Model(
    "inverter",
    "grid-following inverter with a PLL and a controller of the current",
    "RateFlag PQFlag Tg Tfltr Iqrmax Iqrmin rrpwr Te Imax Kip Kii Kppll Kipll wmax wmin Re Xe",
    (
        *limited_currents(),
        Block("Ip_sent", "regulator", "Ip_limited - Id", ("Kip", "Kii")),
        Block("Iq_sent", "regulator", "Iq_into_limited + Iq", ("Kip", "Kii")),
        *source_voltage("Ip_sent", "Iq_sent"),
        Block("pll", "pi", "Vq", ("Kppll", "Kipll"), "wmin", "wmax"),
        Block("angle", "integral", "pll", (1.0,)),
    ),
    optional="Re",
    source=Source("voltage", "Ed", "Eq", ("Re", "Xe", NO_LIMIT), "angle"),
)
