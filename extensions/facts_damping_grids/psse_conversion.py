"""Conversion of PSS/E records (RAW, DYR) to a system.

References: PSS/E Program Operation Manual (power flow raw data), PSS/E Model Library (DYR records).
"""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError
from facts_damping.machine_controls.block_models import MODELS, quantity_of
from facts_damping.machine_controls.blocks import SHORTEST, TABLES
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping_grids import matpower_conversion
from facts_damping_grids import psse_network as network
from facts_damping_grids.matpower_conversion import Imported
from facts_damping_grids.notes import Note, told
from facts_damping_grids.problems import CaseError, problems_of
from facts_damping_grids.psse_reading import Row, read_dyr, read_raw

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping_grids.psse_reading import Dynamic, Dyr, RawCase

# Sections whose records affect the grid; the others do not.
ACTING = ("two-terminal dc", "VSC dc", "multi-terminal dc", "FACTS device", "GNE device", "induction machine")
ROUND = "Td01 Td02 Tq01 Tq02 H D Xd Xq Xd1 Xq1 Xd2 Xl S10 S12"
SALIENT = "Td01 Td02 Tq02 H D Xd Xq Xd1 Xd2 Xl S10 S12"
# Machine models: our names, and their constants in the order of a record.
MACHINES = {
    "GENROU": ("genrou", ROUND),
    "GENROE": ("genrou", ROUND),
    "GENSAL": ("genrou", SALIENT),
    "GENSAE": ("genrou", SALIENT),
    "GENCLS": ("classical", "H D"),
}
HYGOV = "R r Tr Tf Tg rate_max gate_max gate_min Tw At Dt q_nl"
EXPONENTIAL = ("GENROE", "GENSAE")
# Families of models of inverters and wind turbines; their controls, too.
INVERTERS = re.compile(r"REG(C|FM)|REEC|REPC|WT[1-4]|WT(GT|DT|AR|PT|TQ)|PV[GDE]|GEWT|DER_?A|GFM")


def convert(
    case: RawCase, dynamics: Dyr | None, dynamics_name: str = "", *, inverters_as_loads: bool = False
) -> Imported:
    """A case as the content of a system's file. Raises `InputError` with the line of an unsupported record."""
    notes: list[str | Note] = [
        f"{count} {section} records are left out" for section, count in case.unread.items() if section in ACTING
    ]
    buses = network.buses(case, notes)
    units = _units(case, buses, notes)
    lines, shunts = network.lines(case, buses)
    transformers, stars, magnetising = network.transformers(case, buses, notes)
    more, places = _step_ups(case, units)
    transformers += more
    inverters, dynamics = _inverters(units, dynamics)
    if inverters and not inverters_as_loads:
        names = ", ".join(f"{unit.name} ({models})" for unit, models in inverters)
        allowed = "synchronous machines, or --inverters load: negative loads of constant power instead"
        raise InputError(f"{dynamics_name}: inverters given: {names}; allowed: {allowed}")
    for unit, _ in inverters:
        alone = f"{unit.name} is an inverter: a negative load of its constant PG and QG, without inertia and control"
        notes.append(Note(alone, "inverters are negative loads of their constant PG and QG", "generators", unit.name))
        units.remove(unit)
    machines, controls, typical = _machines(units, places, dynamics, dynamics_name, case, buses, notes)
    _check_islands(buses, [*lines, *transformers], machines)
    content: dict[str, Any] = {
        "name": matpower_conversion.system_name(case.name),
        "description": f"{case.name}, imported from PSS/E",
        "base_power": case.base_power,
        "frequency": case.frequency,
        "line_model": "pi",
        "buses": [
            *({"name": f"B{n}", "nominal_voltage": row["BASKV"] or 1.0} for n, row in buses.items()),
            *({"name": name, "nominal_voltage": 1.0} for name in (*stars, *places.values())),
        ],
        "lines": lines,
        "transformers": transformers,
        "loads": [*network.loads(case, buses), *(_negative_load(unit, places) for unit, _ in inverters)],
        "shunts": [*shunts, *magnetising, *network.shunts(case, buses)],
        "machines": machines,
        **controls,
        **matpower_conversion.measured([m["name"] for m in machines]),
    }
    return Imported(matpower_conversion.filled(content), typical, told(notes))


def _check_islands(buses: Mapping[int, Row], branches: Sequence[Row], machines: Sequence[Row]) -> None:
    """Raise `InputError` if branches in service do not connect all buses to the slack machine."""
    slack = next(m["bus"] for m in machines if m.get("slack"))
    reached = matpower_conversion.joined_to(slack, [(row["from"], row["to"]) for row in branches])
    apart = [n for n in buses if f"B{n}" not in reached]
    if apart:
        raise InputError(
            f"bus: an island without the slack machine given ({matpower_conversion.some(apart)}); allowed: one grid"
        )


def import_case(raw: Path, dyr: Path | None = None, *, inverters_as_loads: bool = False) -> Imported:
    """A PSS/E case as a validated system, with notes for the user. Raises `InputError`, also for inverters."""
    case, dynamics = read_raw(raw), None if dyr is None else read_dyr(dyr)
    try:
        imported = convert(case, dynamics, "" if dyr is None else dyr.name, inverters_as_loads=inverters_as_loads)
    except InputError as error:
        raise CaseError(_with_path(text, raw, dyr) for text in problems_of(error)) from error
    check(System, imported.content, str(raw) if dyr is None else f"{raw} with {dyr}")
    notes = [note if dyr and note.startswith(dyr.name) else f"{raw.name}: {note}" for note in imported.notes]
    return imported._replace(notes=notes)


def _with_path(text: str, raw: Path, dyr: Path | None) -> str:
    """A problem with the path of its file."""
    of_dyr = dyr is not None and text.startswith(f"{dyr.name}: ")
    return f"{dyr}: {text.partition(': ')[2]}" if of_dyr else f"{raw}: {text}"


# Machines


class Unit(NamedTuple):
    """A generator in service: its name in the system, its bus and identifier in the case, its record."""

    name: str
    bus: int
    machine: str
    row: Row


def _units(case: RawCase, buses: Mapping[int, Row], notes: list[str | Note]) -> list[Unit]:
    """Generators in service."""
    rows = [row for row in case.tables["generator"] if row["STAT"] == 1 and network.bus_of(row, buses)]
    count = Counter(int(row["I"]) for row in rows)
    if not rows:
        raise InputError("generator: none in service given; allowed: at least one")
    left = len(case.tables["generator"]) - len(rows)
    if left:
        notes.append(f"{left} generators are out of service: left out")
    units = []
    for row in rows:
        n, name = int(row["I"]), f"G{int(row['I'])}"
        units.append(Unit(name if count[n] == 1 else f"{name}_{row['ID']}", n, str(row["ID"]), row))
    return units


def _inverters(units: Sequence[Unit], dynamics: Dyr | None) -> tuple[list[tuple[Unit, str]], Dyr | None]:
    """Units with a record of an inverter and none of a machine, each with its models; the other records."""
    records = dynamics.records if dynamics else ()
    rotating = {(record.bus, record.machine) for record in records if record.model in MACHINES}
    models: dict[tuple[int, str], list[str]] = {}
    for record in records:
        at = record.bus, record.machine
        if at not in rotating and INVERTERS.match(record.model):
            models.setdefault(at, []).append(record.model)
    inverters = [(unit, ", ".join(models[at])) for unit in units if (at := (unit.bus, unit.machine)) in models]
    apart = {(unit.bus, unit.machine) for unit, _ in inverters}
    left = [record for record in records if (record.bus, record.machine) not in apart]
    return inverters, dynamics and dynamics._replace(records=left)


def _negative_load(unit: Unit, places: Mapping[str, str]) -> Row:
    """The power flow's injection of an inverter, kept at any voltage above `V_min` of loads."""
    power = {"power": 1}
    row = {"name": f"inverter_{unit.name}", "bus": places.get(unit.name, f"B{unit.bus}")}
    return row | {"P": -unit.row["PG"], "Q": -unit.row["QG"], "P_fractions": power, "Q_fractions": power}


def _step_ups(case: RawCase, units: Sequence[Unit]) -> tuple[list[Row], dict[str, str]]:
    """Step-up transformers contained in generator records, and the bus of each machine behind one."""
    rows, places = list[Row](), dict[str, str]()
    for unit in units:
        if unit.row["XT"] or unit.row["RT"]:
            places[unit.name] = f"{unit.name}_terminal"
            rating = unit.row["MBASE"] or case.base_power
            ends = {"name": f"T_{unit.name}", "from": f"B{unit.bus}", "to": places[unit.name], "rating": rating}
            rows.append(ends | {"r": unit.row["RT"], "x": unit.row["XT"], "tap": unit.row["GTAP"] or 1.0})
    return rows, places


def _machines(
    units: Sequence[Unit],
    places: Mapping[str, str],
    dynamics: Dyr | None,
    source: str,
    case: RawCase,
    buses: Mapping[int, Row],
    notes: list[str | Note],
) -> tuple[list[Row], dict[str, list[Row]], list[str]]:
    """Machines with the data of their records, their controls by table, and the machines with typical data."""
    by_unit = {(unit.bus, unit.machine): unit for unit in units}
    data: dict[str, Row] = {}
    controls: dict[str, list[Row]] = {table: [] for table in TABLES.values()}
    for line, text in dynamics.unread if dynamics else ():
        alone = f"{source}: line {line}: {text} ... is no record of a machine: left out"
        notes.append(Note(alone, f"{source}: no records of machines: left out", "lines", str(line)))
    for record in dynamics.records if dynamics else ():
        where = f"{source}: line {record.line}: {record.model}"
        unit = by_unit.get((record.bus, record.machine))
        if unit is None:
            alone = f"{where}: no machine {record.machine} at bus {record.bus} in service: left out"
            common = f"{source}: {record.model}: no machine in service: left out"
            notes.append(Note(alone, common, "records", f"{record.machine} at bus {record.bus}"))
        elif record.model in MACHINES:
            if unit.name in data:
                which = f"machine {record.machine} at bus {record.bus}"
                raise InputError(f"{where}: a second model of {which} given; allowed: one")
            data[unit.name] = _machine(record, unit, where, notes)
        else:
            _control(record, unit, where, controls, notes)
    typical = [unit.name for unit in units if unit.name not in data]
    if typical:
        notes.append(matpower_conversion.without_data(typical, len(units)))
    at_reference = [unit for unit in units if buses[unit.bus]["IDE"] == matpower_conversion.REFERENCE]
    if not at_reference:
        raise InputError("bus: no generator in service at a bus of type 3 given; allowed: at least one, no inverter")
    slack = max(at_reference, key=lambda unit: float(unit.row["MBASE"]))
    machines = []
    for unit in units:
        bus, at = buses[unit.bus], places.get(unit.name, f"B{unit.bus}")
        V = unit.row["VS"]
        if bus["IDE"] == matpower_conversion.PQ or (unit.row["IREG"] and unit.row["IREG"] != unit.bus):
            V = bus["VM"]
            alone = f"{unit.name} does not control the voltage of its bus: here it does, at {V:g} p.u."
            common = "do not control the voltage of their buses: here they do"
            notes.append(Note(alone, common, "machines", unit.name))
        elif at != f"B{unit.bus}":
            alone = f"{unit.name} controls its terminal voltage to {V:g} p.u., not that of bus {unit.bus}"
            notes.append(Note(alone, "control their terminal voltage, not that of the bus", "machines", unit.name))
        dispatch = {"slack": True, "angle": bus["VA"]} if unit is slack else {"P": unit.row["PG"]}
        machine = {"name": unit.name, "bus": at, "area": f"area_{int(bus['AREA'])}"}
        machine |= {"rating": unit.row["MBASE"] or case.base_power, "V": V} | dispatch
        machines.append(machine | data.get(unit.name, matpower_conversion.TYPICAL))
    excited = {row["machine"] for row in controls["exciters"]}
    for row in [row for row in controls["stabilisers"] if row["machine"] not in excited]:
        controls["stabilisers"].remove(row)
        alone = f"the stabiliser {row['model']} of {row['machine']}, which has no exciter, is left out"
        notes.append(Note(alone, "stabilisers without an exciter are left out", "machines", row["machine"]))
    return machines, controls, typical


def _machine(record: Dynamic, unit: Unit, where: str, notes: list[str | Note]) -> Row:
    model, order = MACHINES[record.model]
    row: Row = {"model": model, "Ra": unit.row["ZR"], **_constants(record, order, where)}
    if record.model in EXPONENTIAL:
        text = "exponential saturation is taken as quadratic through the same two points"
        notes.append(_of_record(record, unit, where, text))
    if model == "classical":
        return row | {"Xd1": unit.row["ZX"]}
    row["Xq2"] = row["Xd2"]
    if row["S10"] == 0.0 < row["S12"]:
        notes.append(_of_record(record, unit, where, "S(1.0) is 0: without saturation, as in PSS/E"))
    if row["S10"] == 0.0 or row["S12"] <= row["S10"]:
        row["S10"] = row["S12"] = 0.0
    return row


def _control(record: Dynamic, unit: Unit, where: str, controls: dict[str, list[Row]], notes: list[str | Note]) -> None:
    """Add a control's record to its table; note parts that are not modelled."""
    if record.model != "HYGOV" and not (record.model in MODELS and MODELS[record.model].record):
        alone, common = f"{where}: of {unit.name} is not modelled: left out", "is not modelled: left out"
        notes.append(_of_record(record, unit, where, common)._replace(alone=alone))
        return
    table = "governors" if record.model == "HYGOV" else TABLES[MODELS[record.model].role]
    constants = _constants(record, HYGOV if record.model == "HYGOV" else MODELS[record.model].fields, where)
    if any(row["machine"] == unit.name for row in controls[table]):
        raise InputError(f"{where}: {unit.name} has one of the {table} already; allowed: one")
    row: Row = {"machine": unit.name, "model": record.model, **constants}
    if record.model == "HYGOV":
        if row["gate_min"] < 0.001:
            row["gate_min"] = 0.001
            text = "GMIN is raised to 0.001: the flow is divided by the gate"
            notes.append(_of_record(record, unit, where, text))
    else:
        short = [name for name in constants if quantity_of(name).time and 0.0 < row[name] < SHORTEST]
        for name in short:
            row[name] = 0.0
        if short:
            text = f"{', '.join(short)} below {SHORTEST:g} s: taken as 0"
            notes.append(_of_record(record, unit, where, text))
        if "E2" in row and row.get("VRMAX") == 0.0:  # of a rotating exciter: the value for the field voltage E2
            row["VRMAX"] = (max(row["KE"], 0.0) + row["SE2"]) * row["E2"] or 1.0
            row["VRMIN"] = -row["VRMAX"]
            text = f"VRMAX is 0: taken as {row['VRMAX']:.4g}, VRMIN as its negative"
            notes.append(_of_record(record, unit, where, text))
    controls[table].append(row)


def _of_record(record: Dynamic, unit: Unit, where: str, text: str) -> Note:
    """A note on the record of a machine."""
    source = where.partition(": line ")[0]
    return Note(f"{where}: of {unit.name}: {text}", f"{source}: {record.model}: {text}", "machines", unit.name)


def _constants(record: Dynamic, order: str, where: str) -> dict[str, float]:
    """The constants of a record by their names."""
    names = order.split()
    if len(record.values) < len(names):
        raise InputError(f"{where}: {len(record.values)} constants given; allowed: {len(names)}, {' '.join(names)}")
    return dict(zip(names, record.values, strict=False))
