"""REGC_B: an inverter that follows the grid, an EMF behind RE + j XE that gives the currents that are asked for.

    Ip, Iq: Ipcmd, Iqcmd with a lag TG and limits of their rates, together within IMAX (PQFLAG 0: Iq first)
    E = V + (RE + j XE) (Ip - j Iq), with a lag TE, in the direction of V

RRPWR limits how fast the size of Ip grows, or with RATEFLAG 1 that of the power Ip times V (with a lag TFLTR); IQRMAX
how fast Iq rises where Q is above 0 at the start, IQRMIN how fast it falls where it is not. RE, XE: ZSORCE of the
machine's data. Sources: Ramasubramanian et al., Proposed REGC_B and REEC_D (EPRI for WECC, 2020); order of the record
and rates: GridPACK; the sign of rates: PowerSimulationsDynamics.jl (REGCA1).
"""

from __future__ import annotations

from facts_damping.machine_controls.blocks import Model, Source
from facts_damping.plant.machines.blocks import NO_LIMIT
from facts_damping_library.inverters.parts import FOLLOWING, limited_currents, source_voltage

ROW = Model(
    "inverter",
    "grid-following inverter, an EMF behind an impedance",
    "RATEFLAG PQFLAG TG TFLTR IQRMAX IQRMIN RRPWR TE IMAX RE XE",
    (*limited_currents(), *source_voltage("Ip_limited", "Iq_into_limited")),
    factors=FOLLOWING,
    optional="RE",
    source=Source("voltage", "Ed", "Eq", ("RE", "XE", NO_LIMIT)),
)
