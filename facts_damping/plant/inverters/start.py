"""Inverters with their controls at rest, from the solved power flow."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.elementary import magnitude, phase, rect
from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import MODELS
from facts_damping.machine_controls.blocks import number
from facts_damping.numerics.phasors import over, times
from facts_damping.plant.converters.site import INVERTER as PORT_OF_INVERTER
from facts_damping.plant.grid import network
from facts_damping.plant.grid.reduction import Place
from facts_damping.plant.inverters.inverter import (
    CURRENT,
    INVERTER,
    KNOWN,
    MEASURED,
    SETPOINTS,
    STAND_INS,
    THETA,
    THETA_BUS,
    VCOMP,
    VOLTAGE,
)
from facts_damping.plant.machines.block_controls import Control, Signals, control, used_signals, with_states_from
from facts_damping.plant.machines.block_folding import folded
from facts_damping.plant.machines.block_rest import LimitViolation, at_rest

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.compiling.structs import Float1
    from facts_damping.machine_controls.blocks import Source
    from facts_damping.parameters.plant.inverters import Inverter, Meter
    from facts_damping.parameters.plant.system import System
    from facts_damping.plant.grid.power_flow import PowerFlow
    from facts_damping.plant.tables import Ports, States

SIGNALS = Signals(KNOWN, MEASURED, STAND_INS)
REFERENCES = ("Pext", "Qext")


class Inverters(NamedTuple):
    """All inverters at rest: table, rows of blocks, sources (p.u. of the system), limits that exclude the start."""

    rows: NDArray[Any]
    blocks: list[NDArray[Any]]
    sources: list[complex]
    violations: list[LimitViolation]
    failures: list[str]  # of inverters without steady state


def inverters_at_rest(system: System, flow: PowerFlow, states: States, ports: Ports, first: int) -> Inverters:
    """Every inverter at the power flow's operating point; `first`: number of rows of blocks before theirs."""
    started = Inverters(np.zeros(len(system.inverters), INVERTER), [], [], [], [])
    plant_meters = {meter.inverter: (n, meter) for n, meter in enumerate(system.meters)}
    branches = {b.name: b for b in network.branches(system, network.Topology())} if plant_meters else {}
    for i, inverter in enumerate(system.inverters):
        row, voltage = started.rows[i], flow.by_bus[inverter.bus]
        row["ratio"] = inverter.rating / system.base_power
        row["bus"] = row["branch"] = -1
        current = complex(over(flow.generation[inverter.name], voltage)).conjugate() / row["ratio"]
        power = flow.generation[inverter.name] * system.base_power
        data = inverter.model_copy(update={"P": power.real, "Q": power.imag})
        controls = [c for c in system.inverter_controls if c.inverter == inverter.name and c.enabled]
        sensed, wanted = _terminals(row, data, voltage, current, started.violations)
        sensed |= {"omega_0": 2 * math.pi * system.frequency, "speed": 1.0}
        plants = [c for c in controls if hasattr(c, "VCFlag")]
        row["compensation"] = sum(complex(getattr(c, "Rc", 0), getattr(c, "Xc", 0)) for c in plants)
        sensed["Vcomp"] = magnitude(voltage - complex(times(row["compensation"], current)))
        if inverter.name in plant_meters:
            n, meter = plant_meters[inverter.name]
            row["bus"], row["branch"] = n, n if meter.branches else -1
            sensed |= _at_plant(row, meter, flow, branches, current)
        sensed |= {f"{name}0": sensed[name] for name in MEASURED if f"{name}0" in KNOWN}
        assembled = control(data, *controls, signals=SIGNALS)
        used = used_signals(assembled.rows)
        references = [name for name in REFERENCES if name not in assembled.gives and KNOWN.index(name) in used]
        try:
            rest = at_rest(assembled, [data, *controls], sensed, wanted, references, SIGNALS)
        except InputError as error:
            started.failures.append(str(error))
            continue
        started.violations.extend(rest.violations)
        row["sensed"] = rest.signals[: len(KNOWN)]
        assembled = _place(row, assembled, rest.signals, data, first + sum(map(len, started.blocks)))
        started.blocks.append(with_states_from(assembled, states.offset))
        started.sources.append(complex(row["ratio"] * (current + times(row["admittance"], voltage))))
        states.add(inverter.name, assembled.states, rest.states)
        place = Place(inverter.bus, inverter=inverter.name, admittance=complex(row["admittance"] * row["ratio"]))
        row["port"] = ports.add(PORT_OF_INVERTER, i, place)
    _count_alike(started)
    return started


def _count_alike(inverters: Inverters) -> None:
    """Write how many inverters, from each one on, have the same kinds of blocks in the same order."""
    known = inverters.rows["known"] - inverters.rows["first"]
    kinds = [(b["kind"].tolist(), (b["state"] < 0).tolist(), n) for b, n in zip(inverters.blocks, known, strict=False)]
    for i in reversed(range(len(kinds))):
        inverters.rows[i]["alike"] = 1
        if kinds[i : i + 1] == kinds[i + 1 : i + 2]:
            inverters.rows[i]["alike"] += inverters.rows[i + 1]["alike"]


def _terminals(
    row: Any, data: Inverter, voltage: complex, current: complex, violations: list[LimitViolation]
) -> tuple[dict[str, float], dict[str, float]]:
    """What an inverter measures at its terminals, and what its source and angle must be; p.u. of its rating.

    Writes the constants of its source into the row, and the limits of it that exclude the start into `violations`.
    """
    source = _source(data)
    constants = [number(value, data) for value in source.constants]
    row["source"] = CURRENT if source.kind == "current" else VOLTAGE
    size, angle, emf = magnitude(voltage), phase(voltage), 0j
    names = [source.real, source.imag]
    if source.kind == "current":
        for name, value in zip(("V_low", "V_reduced", "V_high", "I_least", "K_high"), constants, strict=True):
            row[name] = value
        turned = complex(times(current, rect(1.0, -angle)))
        values = _before_reduction(row, turned, size)
        if size <= row["V_low"] and turned.real != 0.0:
            violations.append(_beyond(data, 0, "Vt with active current", size, row["V_low"], math.inf))
        if size > row["V_high"] and -turned.imag < row["I_least"] - 1e-9:
            violations.append(_beyond(data, 3, "reactive current", -turned.imag, row["I_least"], math.inf))
    else:
        impedance = complex(constants[0], constants[1])
        row["admittance"], row["I_max"] = over(1.0, impedance), constants[2]
        emf = complex(voltage + times(impedance, current))
        if magnitude(current) > row["I_max"] * (1.0 + 1e-9):
            violations.append(_beyond(data, 2, "current", magnitude(current), 0.0, row["I_max"]))
        angle = phase(emf) if source.forming else angle
        turned = complex(times(emf, rect(1.0, -angle)))
        values = [turned.real, turned.imag]
    frame = rect(1.0, -angle)
    v, i = (complex(phasor) for phasor in times([voltage, current], frame))
    power = complex(times(voltage, current.conjugate()))
    wanted = {name: value for name, value in zip(names, values, strict=True) if name != "none"}
    if source.angle:
        wanted[source.angle] = angle
    sensed = {"Vt": size, "Pe": power.real, "Qe": power.imag, "Vd": v.real, "Vq": v.imag, "Id": i.real, "Iq": i.imag}
    sensed |= {"E0": magnitude(emf), "theta": phase(voltage), "theta_bus": phase(voltage), "Vbus": size}
    return sensed | {"Pbranch": power.real, "Qbranch": power.imag}, wanted


def _source(data: Inverter) -> Source:
    """How the model of an inverter feeds the network."""
    source = MODELS[data.model].source
    if source is None:
        raise InputError(f"inverters: {data.name}.model: {data.model} given, without a source; allowed: with one")
    return source


def _beyond(data: Inverter, constant: int, name: str, value: float, low: float, high: float) -> LimitViolation:
    """A limit of the source that excludes the start; `constant`: which of its constants that is."""
    field = _source(data).constants[constant]
    return LimitViolation(data, name, value, low, high, field if isinstance(field, str) else None, value)


def _before_reduction(row: Any, turned: complex, size: float) -> list[float]:
    """Active current and that in quadrature before `inverter.reduced`."""
    gain = 1.0
    if size < row["V_reduced"]:
        gain = max(0.0, (size - row["V_low"]) / (row["V_reduced"] - row["V_low"]))
    beyond = row["K_high"] * max(0.0, size - row["V_high"])
    return [turned.real / gain if gain > 0.0 else 0.0, float(turned.imag - beyond)]


def _at_plant(
    row: Any, meter: Meter, flow: PowerFlow, branches: dict[str, network.Branch], current: complex
) -> dict[str, float]:
    """What a plant control measures, p.u. of the inverter's rating, whose `current` counts where there is no branch."""
    bus, seen = flow.by_bus[meter.bus], dict[str, float]()
    if meter.branches:
        current = _branch_current(row, meter, flow, branches)
        power = complex(times(bus, current.conjugate()))
        seen = {"Pbranch": power.real, "Qbranch": power.imag}
    compensated = magnitude(bus - complex(times(row["compensation"], current)))
    return seen | {"Vbus": magnitude(bus), "theta_bus": phase(bus), "Vcomp": compensated}


def _branch_current(row: Any, meter: Meter, flow: PowerFlow, branches: dict[str, network.Branch]) -> complex:
    """Current out of the meter's bus into its branch, p.u. of the inverter's rating."""
    branch = branches[meter.branches[0]]
    end = 0 if branch.from_bus == meter.bus else 1
    ends = flow.by_bus[branch.from_bus], flow.by_bus[branch.to_bus]
    return complex(sum(times(branch.admittance[end], np.array(ends)))) / float(row["ratio"])


def _place(row: Any, assembled: Control, signals: Float1, data: Inverter, first: int) -> Control:
    """Write where an inverter's rows stand, and which of its signals are its source; returns the rows that it needs."""
    at, source = {name: n for n, name in enumerate([*KNOWN, *MEASURED, *assembled.gives])}, _source(data)
    constant = [n for n, name in enumerate(KNOWN) if name not in SETPOINTS]
    asked = [at[name] for name in (source.real, source.imag, source.angle or "none")]
    needed, numbers = folded(assembled, signals, constant, asked)
    row["first"], row["known"], row["end"] = first, first + needed.first, first + len(needed.rows)
    row["real"], row["imag"], row["angle"] = numbers
    row["forming"] = source.forms_a_grid
    used = used_signals(needed.rows)
    row["turning"], row["compensated"] = bool(used & {THETA, THETA_BUS}), VCOMP in used
    if not source.angle:
        row["angle"] = -1
    return needed


def power_input(row: Any, blocks: NDArray[Any], name: str) -> int:
    """The signal that adds to an inverter's active power, its plant's if it has one. Raises `InputError` without."""
    used = used_signals(blocks[row["first"] : row["end"]])
    for signal in ("Pplant", "Paux"):
        if KNOWN.index(signal) in used:
            return KNOWN.index(signal)
    raise InputError(f"events: inverter: {name} given; allowed: one whose controls have a setpoint of active power")


def input_signal(row: Any, blocks: NDArray[Any], device: Any) -> int:
    """The signal that a device's setpoint is added to. Raises `InputError` if the inverter's controls do not use it."""
    at = {name: KNOWN.index(name) for name in SETPOINTS}
    used = used_signals(blocks[row["first"] : row["end"]])
    if at[device.input] not in used:
        allowed = ", ".join(name for name, n in at.items() if n in used) or "none"
        raise InputError(
            f"devices: {device.name}.input: {device.input} given, which the controls of {device.inverter} do not use; "
            f"allowed: {allowed}"
        )
    return at[device.input]
