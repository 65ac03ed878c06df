"""Machines with their controls at rest, from the solved power flow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.elementary import magnitude, rect
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.numerics.phasors import over, times
from facts_damping.plant.machines import block_controls, block_rest, blocks, excitation, governor, machine, stabiliser

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.grid.power_flow import PowerFlow
    from facts_damping.plant.machines.block_rest import LimitViolation
    from facts_damping.plant.tables import States


class Rotating(NamedTuple):
    """All machines with their controls: tables, and air-gap powers (p.u. of the ratings)."""

    rows: NDArray[Any]
    exciters: NDArray[Any]
    stabilisers: NDArray[Any]
    governors: NDArray[Any]
    controls: NDArray[Any]
    power: NDArray[np.float64]
    blocks: list[NDArray[Any]]
    violations: list[LimitViolation]


def machines_at_rest(system: System, flow: PowerFlow, states: States) -> Rotating:
    """Every machine with its controls at the power flow's operating point."""
    n = len(system.machines)
    rotating = Rotating(
        np.zeros(n, machine.MACHINE),
        np.zeros(n, excitation.EXCITER),
        np.zeros(n, stabiliser.STABILISER),
        np.zeros(n, governor.GOVERNOR),
        np.zeros(n, blocks.CONTROLS),
        np.zeros(n),
        [],
        [],
    )
    every = [c for c in (*system.exciters, *system.stabilisers, *system.governors) if getattr(c, "enabled", True)]
    tables: dict[tuple[str, str], Any] = {(MODELS[c.model].role, c.machine): c for c in every if c.model in MODELS}
    exciters = {e.machine: e for e in system.exciters if e.model not in MODELS}
    stabilisers = {s.machine: s for s in system.stabilisers if s.enabled and s.model not in MODELS}
    governors = {t.machine: t for t in system.governors if t.enabled and t.model not in MODELS}
    voltage = flow.by_bus
    for g, m in enumerate(system.machines):
        v = voltage[m.bus]
        current = complex(over(flow.generation[m.name], v)).conjugate() * (system.base_power / m.rating)
        start = machine.steady_state(m, system.base_power, states.offset, v, current)
        rotating.rows[g], rotating.power[g] = start.row, start.power
        states.add(m.name, [*machine.SWING, *machine.rotor_circuits(m).names], start.states)
        excited = excitation.steady_state(exciters.get(m.name), states.offset, magnitude(v), start.field_voltage)
        rotating.exciters[g] = excited.row
        states.add(m.name, excited.names, excited.states)
        rotating.stabilisers[g] = stabiliser.row(stabilisers.get(m.name), states.offset)
        if m.name in stabilisers:
            states.add(m.name, stabiliser.STATE_NAMES, [0.0] * len(stabiliser.STATE_NAMES))
        rotating.governors[g] = governor.row(governors.get(m.name), states.offset)
        if m.name in governors:
            turbine, beyond = governor.start(governors[m.name], start.power)
            states.add(m.name, governor.STATE_NAMES, turbine)
            rotating.violations.extend(beyond)
        seen = _sensed(v, current, start)
        for data in [tables[role, m.name] for role in blocks.ROLES if (role, m.name) in tables]:
            rotating.violations.extend(_add_blocks(rotating, g, data, seen, states))
    return rotating


def _sensed(voltage: complex, current: complex, start: machine.MachineStart) -> dict[str, float]:
    """The inputs of block controls at the start, p.u. of the machine's rating."""
    v, i = (complex(phasor) for phasor in times([voltage, current], rect(1.0, math.pi / 2 - float(start.states[0]))))
    power = v.real * i.real + v.imag * i.imag
    sensed = {"Vt": magnitude(v), "Pe": power, "Pa": start.power - power, "Ifd": start.field_voltage, "Pm": start.power}
    return sensed | {"Vd": v.real, "Vq": v.imag, "Id": i.real, "Iq": i.imag, "Vt0": magnitude(v)}


def _add_blocks(rotating: Rotating, g: int, data: Any, seen: dict[str, float], states: States) -> list[LimitViolation]:
    """Add a block control at rest; return the limits that exclude this state."""
    role, control = MODELS[data.model].role, block_controls.control(data)
    wanted, reference = {"exciter": ("Ifd", "Vref"), "governor": ("Pm", "Pref")}.get(role, (None, None))
    sensed, row = {name: value for name, value in seen.items() if name in blocks.SENSED}, rotating.controls[g]
    if role == "exciter":
        control = block_rest.self_excited(control, data, seen["Ifd"])
        row["compensation"] = complex(data.RC, data.XC)
        added = times(row["compensation"], complex(seen["Id"], seen["Iq"]))
        sensed["Vc"] = magnitude(complex(seen["Vd"], seen["Vq"]) + complex(added))
    output, references = block_controls.GIVES[role], [] if reference is None else [reference]
    rest = block_rest.at_rest(control, [data], sensed, {} if wanted is None else {output: seen[wanted]}, references)
    first, rows = sum(map(len, rotating.blocks)), block_controls.with_states_from(control, states.offset)
    row[f"{role}_first"], row[f"{role}_end"] = first, first + len(rows)
    row[f"{role}_gives"], row["Vt0"] = control.gives.index(output), seen["Vt0"]
    if role == "exciter":
        row["Vref"] = rest.references[0]
    elif role == "governor":
        row["power_offset"] = rest.references[0] - seen["Pm"]
    else:  # an unwashed input gives an output at rest, too
        seen["Vs"] = float(rest.signals[len(blocks.SENSED) + row[f"{role}_gives"]])
        rotating.exciters[g]["Vref"] -= seen["Vs"]
    rotating.blocks.append(rows)
    states.add(data.machine, control.states, rest.states)
    return rest.violations
