"""REGC_B: an inverter that follows the grid, an EMF behind Re + j Xe that gives the currents that are asked for.

    Ip, Iq: Ipcmd, Iqcmd with a lag Tg and limits of their rates, together within Imax (PQFlag 0: Iq first)
    E = V + (Re + j Xe) (Ip - j Iq), with a lag Te, in the direction of V

rrpwr limits how fast the size of Ip grows, or with RateFlag 1 that of the power Ip times V (with a lag Tfltr); Iqrmax
how fast Iq rises where Q is above 0 at the start, Iqrmin how fast it falls where it is not. Re, Xe: ZSORCE of the
machine's data. Sources: Ramasubramanian et al., Proposed REGC_B and REEC_D (EPRI for WECC, 2020); order of the record
and rates: GridPACK; the sign of rates: PowerSimulationsDynamics.jl (REGCA1).
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model, Source
from facts_damping.plant.machines.blocks import NO_LIMIT
from facts_damping_library.sources import limited_currents, source_voltage

ROW = Model(
    "inverter",
    "grid-following inverter, an EMF behind an impedance",
    "RateFlag PQFlag Tg Tfltr Iqrmax Iqrmin rrpwr Te Imax Re Xe",
    (*limited_currents(), *source_voltage("Ip_limited", "Iq_into_limited")),
    optional="Re",
    source=Source("voltage", "Ed", "Eq", ("Re", "Xe", NO_LIMIT)),
)
