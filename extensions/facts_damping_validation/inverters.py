"""Inverters against ANDES: its shipped cases by their parameters, power flow, eigenvalues, and a small disturbance.

Where ANDES has an equation otherwise than the specification, ours is put as ANDES has it for the comparison, in
`AS_THERE`: what it has was found by the comparison alone (README.md of `config/references`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.input_files import share_folder
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.machine_controls.blocks import Block
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import read_yaml
from facts_damping.parameters.plant.system import System
from facts_damping.plant.grid.power_flow import solve
from facts_damping.signals import CHANNELS
from facts_damping_validation.as_there import DIVIDES, models_with
from facts_damping_validation.small_signal import CLOSE, eigenvalues, varied
from facts_damping_validation.table import Row, ValidationTable, figures, within
from facts_damping_validation.time_domain import follow

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

FOLDER = "andes_inverters"
CASES = {  # what is compared, and the bus of the conductance; none: no series
    "kundur_reg": ("REGCA1, REECA1, REPCA1", "B7"),
    "kundur_wtds": ("the same with a wind turbine of one mass", "B7"),
    "ieee14_solar": ("REGCA1, REECA1, REPCA1", "B9"),
    "ieee14_reecb1": ("REGCA1, REECB1, REPCA1", "B9"),
    "ieee14_regcp1": ("REGCA1 with a PLL, REECA1, REPCA1", "B9"),
    "ieee14_wt3": ("the same with a wind turbine, its pitch and torque", ""),
}
LATE = 5e-5  # s, by which ANDES's events act: half of its step of 0.1 ms after one
CONDUCTANCE = 0.1  # p.u.
BESIDE_A_KINK = 1e-6  # p.u., by which the voltage of a start is above it, for eigenvalues
SAME_POWER_FLOW, SAME_EQUATIONS = 1e-9, 2e-5  # p.u.; 1/s
STEP = {"voltages": 3e-5, "speeds": 4e-6, "power of the inverter": 6e-5}  # p.u., what ANDES's step may leave
FOREVER = 1e9  # s
AS_THERE = {
    "ESST3A": (
        Block("VE_now", "source", "Vd + Vq + Id + Iq", ("KP", "THETAP", "KI", "XL")),
        Block("VE", "lag", "VE_now", (1.0, FOREVER)),
    ),
    "REECA1": (DIVIDES, Block("P_wanted", "lag", "Pref", (1.0, 0.02))),
    "REECB1": (DIVIDES, Block("Iq_order", "regulator", "V_wanted - Vt0", ("Kvp", "Kvi"))),
    "WTTQA1": (Block("torque_error", "sum", "speed_reference - speed_generator"),),
}
PLL = (
    Block("pll_seen", "lag", "theta", (1.0, 0.05)),
    Block("pll_order", "pi", "pll_seen - pll_angle", (1.0, 0.2)),
    Block("pll_slip", "lag", "pll_order", (1.0, 0.05)),
    Block("pll_turning", "product", "omega_0 + pll_slip"),
    Block("pll_angle", "integral", "pll_turning", (1.0,)),
)


def as_there(case: str) -> AbstractContextManager[None]:
    """With models as ANDES has them."""
    converter = MODELS["REGCA1"]
    if not case.endswith("regcp1") or converter.source is None:
        return models_with(AS_THERE)
    turned = converter.source._replace(angle="pll_angle")
    return models_with(AS_THERE, REGCA1=converter._replace(blocks=(*converter.blocks, *PLL), source=turned))


def system_of(case: str) -> System:
    """A case as a system."""
    return check(System, read_yaml(share_folder() / "config" / "references" / FOLDER / f"{case}.yaml"), case)


def andes() -> ValidationTable:
    """Every case: power flow, all eigenvalues, voltages, speeds and the inverter's power after a conductance."""
    rows = list[Row]()
    for case, (what, bus) in CASES.items():
        system = system_of(case)
        rows.append(_power_flow(f"{case} ({what}): voltages", case, system))
        with as_there(case):
            rows.append(_eigenvalues(f"{case}: all eigenvalues", case, system))
            if bus:
                rows += _after_a_conductance(case, system, bus)
    title = "Inverters and wind turbines"
    return ValidationTable(
        title, "ANDES, steps of 4.2 ms", "facts-damping modes config/references/andes_inverters/kundur_reg.yaml", rows
    )


def _of_case(name: str, case: str) -> NDArray[Any]:
    rows = figures(f"{FOLDER}/{name}")
    return np.asarray(rows[rows["case"] == case])


def _power_flow(what: str, case: str, system: System) -> Row:
    ours = solve(system).by_bus
    theirs = {str(row["bus"]): row["V"] * np.exp(1j * row["angle"]) for row in _of_case("voltages", case)}
    return within(what, "p.u.", [abs(ours[bus] - voltage) for bus, voltage in theirs.items()], SAME_POWER_FLOW)


def _eigenvalues(what: str, case: str, system: System) -> Row:
    """The greatest distance of one of ours from the nearest of theirs, and of one of theirs from the nearest of ours.

    Those of states that act on nothing are not counted, nor those near zero.
    """
    rows = _of_case("eigenvalues", case)
    (inverter,) = system.inverters
    kink = float(inverter.Lvpnt1)  # type: ignore[attr-defined]
    if kink == inverter.V:
        system = varied(system, {"inverters": {"Lvpnt1": kink - BESIDE_A_KINK}})
    both = [values[np.abs(values) > CLOSE] for values in (eigenvalues(system), rows["re"] + 1j * rows["im"])]
    apart = np.abs(both[0][:, None] - both[1][None])
    return within(what, "1/s", np.concatenate([apart.min(axis=0), apart.min(axis=1)]), SAME_EQUATIONS)


def _after_a_conductance(case: str, system: System, bus: str) -> list[Row]:
    """Voltages, speeds and the inverter's power after a conductance of 10 MW at a bus."""
    theirs = figures(f"{FOLDER}/{case}_shunt")
    event = {"kind": "fault", "bus": bus, "time": 1.0 + LATE, "r": 1.0 / CONDUCTANCE}
    ours = follow(system, [], theirs["t"], [event])
    voltage, power = (list(CHANNELS).index(name) for name in ("voltage_magnitude", "active_power"))
    (inverter,) = system.inverters
    at = [pmu.name for pmu in system.pmus].index(inverter.bus)
    pairs = {
        "voltages": [(ours.frames[:, i, voltage], theirs[f"V_{pmu.name}"]) for i, pmu in enumerate(system.pmus)],
        "speeds": [
            (ours.machines["speed_deviation"][:, i], theirs[f"w_{m.name}"] - 1.0) for i, m in enumerate(system.machines)
        ],
        "power of the inverter": [(ours.frames[:, at, power], theirs["P"])],
    }
    return [
        within(f"{case}, 10 MW at {bus}: {what}", "p.u.", [a - b for a, b in of_both], STEP[what])
        for what, of_both in pairs.items()
    ]
