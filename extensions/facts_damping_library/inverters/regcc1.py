"""REGC_C: as REGC_B, with a PLL and a controller of the current.

    i = (KIP + KII/s) (Ip - j Iq - I),  E = V + (RE + j XE) i, with a lag TE, at the PLL's angle
    d angle/dt = (KPPLL + KIPLL/s) Vq, within WMIN and WMAX, rad/s; Vq: across the PLL's direction

Sources: Ramasubramanian et al. (EPRI for WECC, 2021); equations and order of the record: GridPACK.
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Block, Model, Source
from facts_damping.plant.machines.blocks import NO_LIMIT
from facts_damping_library.inverters.parts import FOLLOWING, limited_currents, source_voltage

ROW = Model(
    "inverter",
    "grid-following inverter with a PLL and a controller of the current",
    "RATEFLAG PQFLAG TG TFLTR IQRMAX IQRMIN RRPWR TE IMAX KIP KII KPPLL KIPLL WMAX WMIN RE XE",
    (
        *limited_currents(),
        Block("Ip_order", "regulator", "Ip_limited - Id", ("KIP", "KII")),
        Block("Iq_order", "regulator", "Iq_into_limited + Iq", ("KIP", "KII")),
        *source_voltage("Ip_order", "Iq_order"),
        Block("pll", "pi", "Vq", ("KPPLL", "KIPLL"), "WMIN", "WMAX"),
        Block("angle", "integral", "pll", (1.0,)),
    ),
    factors=FOLLOWING,
    optional="RE",
    source=Source("voltage", "Ed", "Eq", ("RE", "XE", NO_LIMIT), "angle"),
)
