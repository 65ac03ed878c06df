"""Generators of PSS/E records: those in service, and how each stands in the solved power flow."""

from __future__ import annotations

import cmath
import math
import re
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping_grids import matpower_conversion
from facts_damping_grids.notes import Note
from facts_damping_grids.psse import network
from facts_damping_grids.psse.checking import PHYSICAL

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.plant.grid.power_flow import PowerFlow
    from facts_damping_grids.problems import Problems
    from facts_damping_grids.psse.reading import RawCase
    from facts_damping_grids.psse.records import Row


class Unit(NamedTuple):
    """A generator in service: its name in the system, its bus and identifier in the case, its record."""

    name: str
    bus: int
    machine: str
    row: Row
    rating: float  # MVA


class Terminal(NamedTuple):
    """Voltage and power (p.u. of the system base) at the terminals of a unit, behind its step-up transformer if any."""

    voltage: complex
    power: complex

    def behind(self, z: complex, tap: float = 1.0) -> Terminal:
        """Voltage and power on the other side of a transformer, of which they are at the side of the tap."""
        current = tap * (self.power / self.voltage).conjugate()
        voltage = self.voltage / tap + z * current
        return Terminal(voltage, voltage * current.conjugate())

    @property
    def angle(self) -> float:
        """Angle of the voltage, deg."""
        return math.degrees(cmath.phase(self.voltage))


def units(case: RawCase, buses: Mapping[int, Row], notes: list[str | Note], problems: Problems) -> list[Unit]:
    """Generators in service, on their MBASE; where that is 0 on the system base, as in PSS/E.

    Problems: none at a bus of type 3, and two with the same identifier at a bus.
    """
    rows = [row for row in case.tables["generator"] if row["STAT"] == 1 and network.bus_of(row, buses)]
    count, used, places = Counter(int(row["I"]) for row in rows), set[str](), set[tuple[int, str]]()
    listed = []
    for row in rows:
        n, mark, place = int(row["I"]), re.sub(r"[^A-Za-z0-9]", "", str(row["ID"])), identifier(row["ID"])
        if (n, place) in places:
            problems.add(f"{case.where('generator', row)}: {place} stands twice at bus {n}; allowed: each machine once")
        places.add((n, place))
        name = f"G{n}" if count[n] == 1 else f"G{n}_{mark}"
        while name in used:
            name += "x"
        used.add(name)
        rating = abs(row["MBASE"]) or case.base_power
        if row["MBASE"] < 0.0:
            alone = f"line {row['line']}: generator: MBASE of {name} is {row['MBASE']:g}: taken as {rating:g} MVA"
            notes.append(Note(alone, "generator: MBASE below 0: its magnitude is taken", "generators", name))
        listed.append(Unit(name, n, place, row, rating))
    if not any(buses[unit.bus]["IDE"] == matpower_conversion.REFERENCE for unit in listed):
        where = "at a bus of type 3" if listed else "in service"
        problems.add(f"{case.source}: generator: none {where} given; allowed: at least one in service at such a bus")
    return listed


def identifier(text: str) -> str:
    """The identifier of a machine as PSS/E has it: in capital letters, without blanks; none is 1."""
    return str(text).strip().upper() or "1"


def held(listed: Sequence[Unit], buses: Mapping[int, Row], notes: list[str | Note]) -> dict[int, float]:
    """Voltages of the buses with units, p.u.: the scheduled one, or the solved one if no unit there holds it."""
    voltages: dict[int, float] = {}
    holding = {unit.bus: unit.row["VS"] for unit in listed if network.holds_voltage(unit.row, buses[unit.bus])}
    for unit in listed:
        V = holding[unit.bus] if unit.bus in holding else buses[unit.bus]["VM"]
        scheduled = unit.row["VS"]
        voltages[unit.bus] = V
        if abs(V - scheduled) > 0.0:
            alone = f"{unit.name} starts at the voltage of the bus table, {V:g} p.u., not at {scheduled:g}"
            common = "start at the voltage of the bus table: they regulate another bus, or are at a limit of QG"
            notes.append(Note(alone, common, "generators", unit.name))
    return voltages


def at_buses(
    grid: Mapping[str, Any], listed: Sequence[Unit], voltages: Mapping[int, float], buses: Mapping[int, Row]
) -> dict[str, Any]:
    """The content of a system with all units as machines at their buses, for the power flow as PSS/E has it.

    The largest unit at a bus of type 3 is the slack. `grid`: the content without units.
    """
    swing = [unit for unit in listed if buses[unit.bus]["IDE"] == matpower_conversion.REFERENCE]
    slack, machines = max(swing, key=lambda unit: unit.rating), []
    for unit in listed:
        dispatch = {"slack": True, "angle": buses[unit.bus]["VA"]} if unit is slack else {"P": unit.row["PG"]}
        place = {"name": unit.name, "bus": f"B{unit.bus}", "rating": unit.rating, "V": voltages[unit.bus]}
        machines.append(place | dispatch | {"Q": unit.row["QG"]} | matpower_conversion.TYPICAL)
    pmus = [{"name": slack.name, "machine": slack.name}]
    return matpower_conversion.filled({**grid, **PHYSICAL, "machines": machines, "pmus": pmus})


def terminals(flow: PowerFlow, listed: Sequence[Unit]) -> dict[str, Terminal]:
    """Voltage and power of each unit in a power flow, by its name."""
    voltage = flow.by_bus
    return {unit.name: Terminal(voltage[f"B{unit.bus}"], flow.generation[unit.name]) for unit in listed}


def mismatch(buses: Mapping[int, Row], solution: Mapping[str, complex]) -> str:
    """The greatest difference between the voltages of the bus table and those of the power flow, as a note."""
    stored = {n: cmath.rect(row["VM"], math.radians(row["VA"])) for n, row in buses.items()}
    apart = {n: abs(voltage - solution[f"B{n}"]) for n, voltage in stored.items()}
    n = max(apart, key=lambda bus: apart[bus])
    there, here = (f"{abs(v):.5f} p.u., {math.degrees(cmath.phase(v)):.3f} deg" for v in (stored[n], solution[f"B{n}"]))
    return f"power flow: within {apart[n]:.2g} p.u. of the file's voltages; at bus {n} {here}, in the file {there}"
