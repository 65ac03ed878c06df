"""Writes a system as a MATPOWER case (version 2): its network, and its power flow as solved here.

Branches are lines, transformers and series devices. A series device that is not installed leaves only its resistance
and reactance at rest: x is 0 but for a TCSC. Branch model (MATPOWER User's Manual 7.1, 3.2): series admittance, half of
the charging at each end, an ideal transformer at the `from` end. Magnetising branches and the conductance of long lines
have no place in this form and become shunts. Power drawn by loads and DC links at the solved voltages becomes the
demand. A case holds no dynamics; a comment in it says so.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from facts_damping.devices.base import Series
from facts_damping.errors import InputError
from facts_damping.plant.grid.network import Branch, Topology, at_rest, branches, device_section
from facts_damping.plant.grid.power_flow import PowerFlow, solve

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from facts_damping.parameters.plant.grid import InfiniteBus
    from facts_damping.parameters.plant.inverters import Inverter
    from facts_damping.parameters.plant.machines import Machine
    from facts_damping.parameters.plant.system import System

HEADS = {
    "bus": "bus_i type Pd Qd Gs Bs area Vm Va baseKV zone Vmax Vmin",
    "gen": "bus Pg Qg Qmax Qmin Vg mBase status Pmax Pmin",
    "branch": "fbus tbus r x b rateA rateB rateC ratio angle status angmin angmax",
}
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")  # name of a MATLAB function
KEYWORDS = (
    *("break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if"),
    *("otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while"),
)
PQ, PV, REFERENCE = 1, 2, 3
NOTHING = 1e-12  # p.u.; smaller values of charging or phase shift are round-off

Row = tuple[list[float], str]  # row of a table, and the name of its element


def export(system: System, path: Path) -> str:
    """Text of a MATPOWER case, a function named after its file. Raises `InputError` for a name that MATLAB refuses."""
    if not NAME.fullmatch(path.stem) or path.stem in KEYWORDS:
        allowed = "a name of letters, digits and _ that MATLAB takes for a function"
        raise InputError(f"--out {path}: given; allowed: {allowed}")
    return text(system, path.stem)


def text(system: System, name: str) -> str:
    """The case as a MATLAB function of that name. Raises `InputError` if the power flow has no solution."""
    base = system.base_power
    lines = [
        f"function mpc = {name}",
        f"% {system.name}: {' '.join(system.description.split())}",
        "% Written by facts-damping export: network and power flow. Dynamics of machines and inverters, their controls",
        "% and FACTS devices are not part of a MATPOWER case.",
        "mpc.version = '2';",
        f"mpc.baseMVA = {base:.15g};",
    ]
    for key, rows in _tables(system).items():
        lines += [f"\n% {HEADS[key]}", f"mpc.{key} = [", *(_line(row, element) for row, element in rows), "];"]
    return "\n".join(lines) + "\n"


def _tables(system: System) -> dict[str, list[Row]]:
    """Rows of all tables; MW, Mvar, p.u., degrees."""
    flow, base = solve(system), system.base_power
    numbers = {bus.name: i for i, bus in enumerate(system.buses, 1)}
    shunt = np.zeros(len(numbers), complex)  # MW drawn and Mvar supplied at 1 p.u.
    for one_shunt in system.shunts:
        shunt[numbers[one_shunt.bus] - 1] += complex(one_shunt.P, one_shunt.Q)
    series = [device_section(d, at_rest(d)) for d in system.devices if isinstance(d, Series)]
    branch_rows: list[Row] = []
    for branch in [*branches(system, Topology()), *series]:
        branch_row, ends = _branch(branch, numbers)
        branch_rows.append((branch_row, branch.name))
        for bus_name, y in zip((branch.from_bus, branch.to_bus), ends, strict=True):
            shunt[numbers[bus_name] - 1] += y * base
    generators, types, generation = _generators(system, flow, numbers)
    demand = generation - flow.injection * base
    buses: list[Row] = []
    for i, bus in enumerate(system.buses):
        v, d, s = flow.voltage[i], _plain(demand[i], base), _plain(shunt[i], base)
        angle = float(np.rad2deg(np.angle(v)))
        bus_row = [i + 1, types[i], d.real, d.imag, s.real, s.imag, 1, abs(v), angle, bus.nominal_voltage, 1, 1.1, 0.9]
        buses.append((bus_row, bus.name))
    return {"bus": buses, "gen": generators, "branch": branch_rows}


def _plain(power: complex, base: float) -> complex:
    return power if abs(power) > NOTHING * base else 0j


def _generators(
    system: System, flow: PowerFlow, numbers: dict[str, int]
) -> tuple[list[Row], list[int], NDArray[np.complex128]]:
    """Machines, inverters and infinite buses as generators, the types of all buses, and the generation at each, MVA.

    An inverter that holds no voltage has limits of reactive power that are its schedule, so that its bus stays PQ.
    """
    base = system.base_power
    generation, rows, types = np.zeros(len(numbers), complex), list[Row](), [PQ] * len(numbers)
    ratings = {unit.name: unit.rating for unit in system.units}
    fixed = {row.name for row in system.infinite_buses} | {unit.name for unit in system.units if unit.slack}
    sources: list[InfiniteBus | Machine | Inverter] = [*system.infinite_buses, *system.units]
    for source in sources:
        at, power = numbers[source.bus] - 1, flow.generation[source.name] * base
        generation[at] += power
        rating = ratings.get(source.name, max(base, abs(power)))
        Q_max, Q_min, V = rating, -rating, source.V
        if V is None:
            Q_max = Q_min = power.imag
            V = abs(flow.voltage[at])
        else:
            types[at] = REFERENCE if source.name in fixed else max(types[at], PV)
        P_max, P_min = max(rating, power.real), min(0.0, power.real)
        generator_row = [at + 1, power.real, power.imag, Q_max, Q_min, V, rating, 1, P_max, P_min]
        rows.append((generator_row, source.name))
    return rows, types, generation


def _branch(branch: Branch, numbers: dict[str, int]) -> tuple[list[float], tuple[complex, complex]]:
    """Row of a branch by its 2 x 2 admittance, and the shunt admittances at its ends that the row cannot hold."""
    (y_ff, y_ft), (y_tf, y_tt) = branch.admittance
    turn = y_ft / y_tf  # t / conj(t); t: ratio at the `from` end
    shift = float(0.5 * np.angle(turn))
    straight = abs(y_ft - y_tf) <= NOTHING * abs(y_ft) and abs(y_ff - y_tt) <= 1e-9 * abs(y_ff)
    # For a line y_ff = y_tt = y + shunt; for a transformer y_tt = y: its magnetising branch is at the other end.
    ratio = 1.0 if straight else float(abs(y_tt / y_tf))
    series = -y_tf * ratio * np.exp(1j * shift)
    z = 1.0 / series
    left = y_ff - series / ratio**2, y_tt - series
    charging = 2.0 * float(min(left[0].imag, left[1].imag)) if straight else 0.0
    left = left[0] - 0.5j * charging, left[1] - 0.5j * charging
    angle = float(np.rad2deg(shift)) if abs(shift) > NOTHING else 0.0
    tap = 0.0 if straight else ratio
    row = [
        numbers[branch.from_bus],
        numbers[branch.to_bus],
        z.real,
        z.imag,
        charging,
        0,
        0,
        0,
        tap,
        angle,
        1,
        -360,
        360,
    ]
    return [0.0 if abs(value) < NOTHING else float(value) for value in row], left


def _line(row: Sequence[float], name: str) -> str:
    return "\t" + "\t".join(f"{float(value):.15g}" for value in row) + f";\t% {name}"
