"""Grid-following inverters against PSTess: two areas with REEC_D, eigenvalues, steps, a brake.

Where PSTess is otherwise than the specification, ours is put as PSTess has it (README.md of `config/references`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.machine_controls.blocks import Block
from facts_damping.plant.grid.power_flow import solve
from facts_damping_validation.as_there import models_with
from facts_damping_validation.grid_forming import BRAKE
from facts_damping_validation.pstess import INVERTERS, Bound, disturbance_rows, eigenvalue_rows, system_of
from facts_damping_validation.table import Row, figures

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System

STEPS = {"Q1": -0.02, "V11": 0.02}  # p.u.
SOLVED = "PSTess solves the buses of these inverters to 1e-6 p.u. and takes differences of 1e-4"
LOWEST = 0.1  # p.u., below which the loads of `as_there` are impedances
REECD1 = (
    # Q is seen through a lag of 50 ms; the step of the voltage is one of the reference of its support.
    Block("Q_seen", "lag", "Qe", (1.0, 0.05)),
    Block("V_order", "regulator", "Q_order - Q_seen", ("Kqp", "Kqi"), "Vmin", "Vmax", hold="dip"),
    Block("V_wanted", "sum", "V_order", (), "Vmin", "Vmax"),
    Block("V_deviation", "sum", "Vref0 * one + AT_START * Vt0 - V_seen + Vaux"),
    # |V exp(j theta) - j Xc (P + j Q) / V|: the current neither conjugate nor turned with the voltage.
    Block("cosine_theta", "cosine", "theta"),
    Block("sine_theta", "sine", "theta"),
    Block("active_cosine", "product", "Id + cosine_theta"),
    Block("active_sine", "product", "Id + sine_theta"),
    Block("leading_cosine", "product", "Iq + cosine_theta"),
    Block("leading_sine", "product", "Iq + sine_theta"),
    Block("V_along", "sum", "Vt - Xc * leading_cosine - Xc * active_sine"),
    Block("V_across", "sum", "Xc * leading_sine - Xc * active_cosine"),
    Block("V_compensated", "magnitude", "V_along + V_across"),
)


def eigenvalues() -> list[Row]:
    """Eigenvalues as shipped."""
    with models_with({"REECD1": REECD1}):
        return eigenvalue_rows("reec", _as_there(), Bound(0.012, SOLVED), Bound(0.005, SOLVED))


def disturbances() -> list[Row]:
    """Steps of references, and a brake."""
    with models_with({"REECD1": REECD1}):
        return [
            *disturbance_rows("steps of Q and Vref, REEC_D", _into_the_network("steps"), _as_there(), setpoints=STEPS),
            *disturbance_rows("brake of 50 MW at B20, REEC_D", _into_the_network("brake"), _as_there(), [BRAKE]),
        ]


def _as_there() -> System:
    """PSTess's system, with what its buses of inverters draw besides: S0 less S0 V/V0, nothing at the start."""
    system = system_of("two_area_reec")
    content, at_start = system.model_dump(by_alias=True), solve(system).generation
    for inverter in system.inverters:
        S = at_start[inverter.name] * system.base_power
        for kind, sign in (("power", 1.0), ("current", -1.0)):
            load = {"name": f"{inverter.name}_{kind}", "bus": inverter.bus, "P": sign * S.real, "Q": sign * S.imag}
            content["loads"].append(load | {"P_fractions": {kind: 1}, "Q_fractions": {kind: 1}, "V_min": LOWEST})
    return type(system).model_validate(content)


def _into_the_network(run: str) -> NDArray[np.void]:
    """PSTess's columns, with P and Q as its network gets them, S + S0 V/V0 - S0."""
    columns = figures(f"pstess/reec_{run}")
    for bus in INVERTERS:
        V = columns[f"V{bus}"]
        for power in ("P", "Q"):
            columns[f"{power}{bus}"] += columns[f"{power}{bus}"][0] * (V / V[0] - 1.0)
    return columns
