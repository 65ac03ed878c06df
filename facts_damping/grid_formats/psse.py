"""From PSS/E records (RAW, DYR) to a system: the network, machines and their controls, and what was put in whose place.

References: PSS/E Program Operation Manual (power flow raw data), PSS/E Model Library (DYR records).
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError
from facts_damping.grid_formats.conversion import TYPICAL, Imported
from facts_damping.grid_formats.psse_dyr import read_dyr
from facts_damping.grid_formats.psse_raw import Row, read_raw
from facts_damping.parameters.blocks import MODELS, SHORTEST, quantity_of
from facts_damping.parameters.system import System
from facts_damping.parameters.validation import check

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping.grid_formats.psse_dyr import Dynamic, Dyr
    from facts_damping.grid_formats.psse_raw import RawCase

PQ, SLACK, ISOLATED = 1, 3, 4  # bus types
TABLE = {"exciter": "exciters", "stabiliser": "stabilisers", "governor": "governors"}
# Machine models: ours, and their constants in the order of a record.
MACHINES = {
    "GENROU": ("genrou", "Td01 Td02 Tq01 Tq02 H D Xd Xq Xd1 Xq1 Xd2 Xl S10 S12"),
    "GENROE": ("genrou", "Td01 Td02 Tq01 Tq02 H D Xd Xq Xd1 Xq1 Xd2 Xl S10 S12"),
    "GENSAL": ("genrou", "Td01 Td02 Tq02 H D Xd Xq Xd1 Xd2 Xl S10 S12"),
    "GENSAE": ("genrou", "Td01 Td02 Tq02 H D Xd Xq Xd1 Xd2 Xl S10 S12"),
    "GENCLS": ("classical", "H D"),
}
HYGOV = "R r Tr Tf Tg rate_max gate_max gate_min Tw At Dt q_nl"
INSTEAD = {
    "GENROE": "its exponential saturation is taken as quadratic through the same two points",
    "GENSAE": "its exponential saturation is taken as quadratic through the same two points",
}


class Unit(NamedTuple):
    """A generator in service: its name here, its bus and identifier in the case, its record."""

    name: str
    bus: int
    machine: str
    row: Row


def convert(case: RawCase, dynamics: Dyr | None, dynamics_name: str = "") -> Imported:
    """A case as the content of a system's file. Raises `InputError` with the line of a record that cannot be taken."""
    notes = [f"{count} {section} records are left out" for section, count in case.unread.items() if section in ACTING]
    buses = _buses(case, notes)
    units = _units(case, buses, notes)
    lines, shunts = _lines(case, buses)
    transformers, stars, magnetising = _transformers(case, buses, notes)
    step_ups, places = _step_ups(case, units)
    machines, controls, typical = _dynamics(units, places, dynamics, dynamics_name, case, buses, notes)
    _check_islands(buses, [*lines, *transformers], machines)
    names = [m["name"] for m in machines]
    pairs = {f"w_{names[0]}_{other}": other for other in names[1:]}
    content: dict[str, Any] = {
        "name": re.sub(r"[^A-Za-z0-9_.+-]", "_", case.name).lstrip("_.+-")[:64] or "case",
        "description": f"{case.name}, imported from PSS/E",
        "base_power": case.base_power,
        "frequency": case.frequency,
        "line_model": "pi",
        "buses": [
            *({"name": f"B{n}", "nominal_voltage": row["BASKV"] or 1.0} for n, row in buses.items()),
            *({"name": name, "nominal_voltage": 1.0} for name in (*stars, *places.values()) if not _is_plain(name)),
        ],
        "lines": lines,
        "transformers": [*transformers, *step_ups],
        "loads": _loads(case, buses),
        "shunts": [*shunts, *magnetising, *_shunts(case, buses)],
        "machines": machines,
        **controls,
        "stations": [{"name": name, "machine": name} for name in names],
        "signals": {s: {"channel": "speed_deviation", "weights": {names[0]: 1, o: -1}} for s, o in pairs.items()},
        "measures": {"local": list(pairs)},
    }
    return Imported({key: value for key, value in content.items() if value not in ([], {})}, typical, notes)


# Records of these sections would act; the others say nothing of the grid itself.
ACTING = ("two-terminal dc", "VSC dc", "multi-terminal dc", "FACTS device", "GNE device", "induction machine")


def _is_plain(name: str) -> bool:
    """Whether a bus is one of the case."""
    return re.fullmatch(r"B\d+", name) is not None


def _buses(case: RawCase, notes: list[str]) -> dict[int, Row]:
    """Buses in service by their numbers."""
    buses: dict[int, Row] = {}
    for row in case.tables["bus"]:
        number = int(row["I"])
        if number in buses:
            raise InputError(f"line {row['line']}: bus: {number} stands twice; allowed: each bus once")
        buses[number] = row
    out = [n for n, row in buses.items() if row["IDE"] == ISOLATED]
    if out:
        notes.append(f"isolated buses are left out: {', '.join(map(str, out))}")
    for section in ("branch", "transformer"):
        for row in case.tables[section]:
            for end in ("I", "J", *(["K"] if row.get("K") else [])):
                if abs(int(row[end])) not in buses:
                    raise InputError(f"line {row['line']}: {section}: {end} = {row[end]:g} given; allowed: a bus")
    return {n: row for n, row in buses.items() if row["IDE"] != ISOLATED}


def _at(row: Row, buses: Mapping[int, Row]) -> int | None:
    """The bus of a record; none: it is isolated, or not there."""
    return int(row["I"]) if int(row["I"]) in buses else None


def _check_islands(buses: Mapping[int, Row], branches: Sequence[Row], machines: Sequence[Row]) -> None:
    """Raise `InputError` where branches in service do not join all buses to the slack machine."""
    near: dict[str, set[str]] = {f"B{n}": set() for n in buses}
    for row in branches:
        near.setdefault(row["from"], set()).add(row["to"])
        near.setdefault(row["to"], set()).add(row["from"])
    start = next(str(m["bus"]).removesuffix("_terminal") for m in machines if m.get("slack"))
    start = start if start in near else f"B{re.findall(r'[0-9]+', start)[0]}"
    reached, edge = {start}, {start}
    while edge:
        edge = set().union(*(near[name] for name in edge)) - reached
        reached |= edge
    apart = [n for n in buses if f"B{n}" not in reached]
    if apart:
        told = ", ".join(map(str, apart[:5])) + (", ..." if len(apart) > 5 else "")
        raise InputError(f"bus: an island without the slack machine given ({told}); allowed: one grid")


def _units(case: RawCase, buses: Mapping[int, Row], notes: list[str]) -> list[Unit]:
    """Generators in service."""
    rows = [row for row in case.tables["generator"] if row["STAT"] == 1 and _at(row, buses)]
    count: dict[int, int] = {}
    for row in rows:
        count[int(row["I"])] = count.get(int(row["I"]), 0) + 1
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


def _lines(case: RawCase, buses: Mapping[int, Row]) -> tuple[list[Row], list[Row]]:
    """Lines in service, and the shunts at their ends."""
    lines, shunts, taken = list[Row](), list[Row](), set[str]()
    for row in case.tables["branch"]:
        a, b = abs(int(row["I"])), abs(int(row["J"]))
        if row["ST"] != 1 or a not in buses or b not in buses:
            continue
        if row["X"] == 0.0 or a == b:
            what = f"X = {row['X']:g}" if a != b else f"bus {a} at both ends"
            raise InputError(f"line {row['line']}: branch: {what} given; allowed: two buses, X other than 0")
        name = _free(f"line_{a}_{b}", row["CKT"], taken)
        lines.append({"name": name, "from": f"B{a}", "to": f"B{b}", "r": row["R"], "x": row["X"], "b": row["B"]})
        for bus, G, B in ((a, row["GI"], row["BI"]), (b, row["GJ"], row["BJ"])):
            if G or B:
                own = {"name": f"shunt_{name}_{bus}", "bus": f"B{bus}", "Q": B * case.base_power}
                shunts.append(own | {"P": G * case.base_power})
    return lines, shunts


def _free(stem: str, circuit: str, taken: set[str]) -> str:
    """A name that no other branch has: with its circuit where that is not the first."""
    mark = re.sub(r"[^A-Za-z0-9]", "", str(circuit))
    name = stem if mark in ("", "1") else f"{stem}_{mark}"
    while name in taken:
        name += "x"
    taken.add(name)
    return name


def _loads(case: RawCase, buses: Mapping[int, Row]) -> list[Row]:
    """Loads: what is constant power in the power flow is an impedance in the dynamics, as our loads are."""
    loads = []
    for row in case.tables["load"]:
        n = _at(row, buses)
        if n is None or row["STATUS"] != 1:
            continue
        stem = f"load_{n}" if row["ID"] in ("1", "") else f"load_{n}_{row['ID']}"
        shares = {"P_shares": {"current": 1}, "Q_shares": {"current": 1}, "at": "nominal"}
        parts: Any = (
            ("", row["PL"], row["QL"], {}),
            ("_current", row["IP"], row["IQ"], shares),
            ("_impedance", row["YP"], -row["YQ"], {"at": "nominal"}),
        )
        loads += [{"name": stem + end, "bus": f"B{n}", "P": P, "Q": Q} | more for end, P, Q, more in parts if P or Q]
    return loads


def _shunts(case: RawCase, buses: Mapping[int, Row]) -> list[Row]:
    """Fixed shunts, and switched ones as they stand."""
    made = []
    for section, G, B, on in (("fixed shunt", "GL", "BL", "STATUS"), ("switched shunt", None, "BINIT", "ST")):
        taken = set[str]()
        for row in case.tables[section]:
            n = _at(row, buses)
            if n is None or row[on] != 1 or not (row[B] or (G and row[G])):
                continue
            name = _free(f"{section.split()[0]}_{n}", row.get("ID", "1"), taken)
            made.append({"name": name, "bus": f"B{n}", "Q": row[B], "P": row[G] if G else 0.0})
    return made


# Transformers ---------------------------------------------------------------------------------------------------------


class Winding(NamedTuple):
    """A winding: its bus, the ratio of its voltage to that of the bus (p.u.), and its angle (deg)."""

    bus: int
    ratio: float
    angle: float


def _winding(row: Row, number: int, end: str, buses: Mapping[int, Row]) -> Winding:
    """A winding of a transformer; CW: 1: p.u. of the bus, 2: kV, 3: p.u. of the winding's nominal voltage."""
    n, value = int(row[end]), row[f"WINDV{number}"]
    base, nominal = buses[n]["BASKV"] or 1.0, row[f"NOMV{number}"]
    if row["CW"] == 2:
        value /= base
    elif row["CW"] == 3 and nominal:
        value *= nominal / base
    return Winding(n, value, row[f"ANG{number}"])


def _impedance(row: Row, number: int, base_power: float) -> complex:
    """R + j X of a pair of windings, p.u. of the system base.

    CZ: 1: p.u. of the system base, 2: of the pair's rating, 3: load loss (W) and |Z| of the rating.
    """
    r, x, rating = (float(row[f"{name}{number}"]) for name in ("R", "X", "S"))
    if row["CZ"] == 1:
        return complex(r, x)
    if not rating > 0.0:
        raise InputError(f"line {row['line']}: transformer: SBASE = {rating:g} given; allowed: above 0")
    if row["CZ"] == 3:
        r = r / 1e6 / rating
        x = math.sqrt(max(0.0, x * x - r * r))
    return complex(r, x) * base_power / rating


def _transformers(case: RawCase, buses: Mapping[int, Row], notes: list[str]) -> tuple[list[Row], list[str], list[Row]]:
    """Transformers of two windings, those of three as stars, the buses of the stars, and magnetising shunts."""
    made, stars, shunts, taken = list[Row](), list[str](), list[Row](), set[str]()
    for row in case.tables["transformer"]:
        ends = [end for end in ("I", "J", "K") if row[end]]
        if row["STAT"] == 0 or any(int(row[end]) not in buses for end in ends):
            continue
        own = [_winding(row, i, end, buses) for i, end in enumerate(ends, 1)]
        name = _free("T" + "_".join(str(int(row[end])) for end in ends), row["CKT"], taken)
        for w in own:
            if not 0.5 < w.ratio < 2.0:
                raise InputError(f"line {row['line']}: transformer: ratio {w.ratio:g} given; allowed: 0.5 to 2")
        z = [_impedance(row, i, case.base_power) for i in range(1, 2 if len(ends) == 2 else 4)]
        if len(ends) == 2:
            made.append(_two_windings(name, f"B{own[0].bus}", f"B{own[1].bus}", own[0], own[1].ratio, z[0], row, case))
            turn = own[0].angle - own[1].angle
            made[-1] |= {"phase_shift": turn} if turn else {}
        else:
            star = f"{name}_star"
            stars.append(star)
            arms = [(z[0] + z[2] - z[1]) / 2, (z[0] + z[1] - z[2]) / 2, (z[1] + z[2] - z[0]) / 2]
            out = {2: 1, 3: 2, 4: 0}.get(int(row["STAT"]))
            for i, (w, arm) in enumerate(zip(own, arms, strict=True)):
                if i != out:
                    made.append(_two_windings(f"{name}_{i + 1}", f"B{w.bus}", star, w, 1.0, arm, row, case))
                    made[-1] |= {"phase_shift": w.angle} if w.angle else {}
        shunts += _magnetising(row, own[0].bus, name, case, notes)
    return made, stars, shunts


def _two_windings(
    name: str, start: str, end: str, first: Winding, second: float, z: complex, row: Row, case: RawCase
) -> Row:
    """A transformer of ours: its tap at the first bus, its impedance beside the second."""
    z *= second * second
    if z.imag == 0.0:
        raise InputError(f"line {row['line']}: transformer: X = 0 given; allowed: another value")
    tap = first.ratio / second
    values = {"name": name, "from": start, "to": end, "rating": case.base_power, "r": z.real, "x": z.imag}
    return values | ({"tap": tap} if tap != 1.0 else {})


def _magnetising(row: Row, bus: int, name: str, case: RawCase, notes: list[str]) -> list[Row]:
    """The magnetising branch as a shunt at the first bus; CM: 1: G and B of the system base, 2: W and p.u. current."""
    G, B = row["MAG1"], row["MAG2"]
    if not (G or B):
        return []
    if row["CM"] == 2:
        rating = row["S1"] or case.base_power
        G, current = G / 1e6 / case.base_power, B * rating / case.base_power
        B = -math.sqrt(max(0.0, current * current - G * G))
    notes.append(f"line {row['line']}: the magnetising branch of {name} is a shunt, which stays when it opens")
    return [{"name": f"magnetising_{name}", "bus": f"B{bus}", "Q": B * case.base_power, "P": G * case.base_power}]


def _step_ups(case: RawCase, units: Sequence[Unit]) -> tuple[list[Row], dict[str, str]]:
    """Step-up transformers that are part of generators' records, and the bus of each machine behind one."""
    made, places = list[Row](), dict[str, str]()
    for unit in units:
        if unit.row["XT"] or unit.row["RT"]:
            places[unit.name] = f"{unit.name}_terminal"
            rating = unit.row["MBASE"] or case.base_power
            ends = {"name": f"T_{unit.name}", "from": f"B{unit.bus}", "to": places[unit.name], "rating": rating}
            made.append(ends | {"r": unit.row["RT"], "x": unit.row["XT"], "tap": unit.row["GTAP"] or 1.0})
    return made, places


# Machines and controls ------------------------------------------------------------------------------------------------


def _dynamics(
    units: Sequence[Unit],
    places: Mapping[str, str],
    dynamics: Dyr | None,
    source: str,
    case: RawCase,
    buses: Mapping[int, Row],
    notes: list[str],
) -> tuple[list[Row], dict[str, list[Row]], list[str]]:
    """Machines with the data of their records, their controls by table, and the machines with typical data."""
    by_unit = {(unit.bus, unit.machine): unit for unit in units}
    data: dict[str, Row] = {}
    controls: dict[str, list[Row]] = {table: [] for table in TABLE.values()}
    for line, text in dynamics.unread if dynamics else ():
        notes.append(f"{source}: line {line}: {text} ... is no record of a machine: left out")
    for record in dynamics.records if dynamics else ():
        where = f"{source}: line {record.line}: {record.model}"
        unit = by_unit.get((record.bus, record.machine))
        if unit is None:
            notes.append(f"{where}: no machine {record.machine} at bus {record.bus} in service: left out")
        elif record.model in MACHINES:
            if unit.name in data:
                raise InputError(
                    f"{where}: a second model of machine {record.machine} at bus {record.bus} given; allowed: one"
                )
            data[unit.name] = _machine(record, unit, where, notes)
        else:
            _control(record, unit, where, controls, notes)
    typical = [unit.name for unit in units if unit.name not in data]
    if typical:
        which = "all machines" if len(typical) == len(units) else ", ".join(typical)
        notes.append(f"no dynamic data for {which}: typical data (Kundur, table 4.2)")
    slack = _slack(units, buses)
    machines = []
    for unit in units:
        bus, at = buses[unit.bus], places.get(unit.name, f"B{unit.bus}")
        V = unit.row["VS"]
        if bus["IDE"] == PQ or (unit.row["IREG"] and unit.row["IREG"] != unit.bus):
            V = bus["VM"]
            notes.append(f"{unit.name} does not hold the voltage of its bus: here it holds {V:g} p.u. there")
        elif at != f"B{unit.bus}":
            notes.append(f"{unit.name} holds {V:g} p.u. at its own terminals, not at bus {unit.bus}")
        dispatch = {"slack": True, "angle": bus["VA"]} if unit is slack else {"P": unit.row["PG"]}
        made = {"name": unit.name, "bus": at, "area": f"area_{int(bus['AREA'])}"}
        made |= {"rating": unit.row["MBASE"] or case.base_power, "V": V} | dispatch
        machines.append(made | data.get(unit.name, TYPICAL))
    excited = {row["machine"] for row in controls["exciters"]}
    for row in [row for row in controls["stabilisers"] if row["machine"] not in excited]:
        controls["stabilisers"].remove(row)
        notes.append(f"the stabiliser {row['model']} of {row['machine']}, which has no exciter, is left out")
    return machines, controls, typical


def _slack(units: Sequence[Unit], buses: Mapping[int, Row]) -> Unit:
    """The machine that balances the power flow: of those at a bus of type 3 the largest."""
    there = [unit for unit in units if buses[unit.bus]["IDE"] == SLACK]
    if not there:
        raise InputError("bus: no generator in service at a bus of type 3 given; allowed: at least one")
    return max(there, key=lambda unit: float(unit.row["MBASE"]))


def _machine(record: Dynamic, unit: Unit, where: str, notes: list[str]) -> Row:
    """The data of a machine's record."""
    model, order = MACHINES[record.model]
    names = order.split()
    if len(record.values) < len(names):
        raise InputError(f"{where}: {len(record.values)} constants given; allowed: {len(names)}, {order}")
    row: Row = {"model": model, "Ra": unit.row["ZR"], **dict(zip(names, record.values, strict=False))}
    if record.model in INSTEAD:
        notes.append(f"{where}: {INSTEAD[record.model]}")
    if model == "classical":
        return row | {"Xd1": unit.row["ZX"]}
    row["Xq2"] = row["Xd2"]
    if row["S12"] <= row["S10"]:
        row["S10"] = row["S12"] = 0.0
    return row


def _control(record: Dynamic, unit: Unit, where: str, controls: dict[str, list[Row]], notes: list[str]) -> None:
    """Take a control's record into its table; what is not modelled is named."""
    if record.model != "HYGOV" and record.model not in MODELS:
        notes.append(f"{where}: of {unit.name} is not modelled: left out")
        return
    names = (HYGOV if record.model == "HYGOV" else MODELS[record.model].fields).split()
    table = "governors" if record.model == "HYGOV" else TABLE[MODELS[record.model].role]
    if len(record.values) < len(names):
        raise InputError(f"{where}: {len(record.values)} constants given; allowed: {len(names)}, {' '.join(names)}")
    if any(row["machine"] == unit.name for row in controls[table]):
        raise InputError(f"{where}: a second one of the {table} of {unit.name} given; allowed: one")
    row: Row = {"machine": unit.name, "model": record.model, **dict(zip(names, record.values, strict=False))}
    if record.model == "HYGOV":
        if row["gate_min"] < 0.001:
            row["gate_min"] = 0.001
            notes.append(f"{where}: of {unit.name}: GMIN is raised to 0.001, as the head has the gate below it")
    else:
        short = [name for name in names if quantity_of(name).time and 0.0 < row[name] < SHORTEST]
        for name in short:
            row[name] = 0.0
        if short:
            notes.append(f"{where}: of {unit.name}: {', '.join(short)} below {SHORTEST:g} s: taken as 0")
        _complete(row, where, unit, notes)
    controls[table].append(row)


def _complete(row: Row, where: str, unit: Unit, notes: list[str]) -> None:
    """A rotating exciter whose VRMAX is 0 has the one that the field voltage E2 needs, as PSS/E has it."""
    if "E2" in row and row.get("VRMAX") == 0.0:
        row["VRMAX"] = (max(row["KE"], 0.0) + row["SE2"]) * row["E2"] or 1.0
        row["VRMIN"] = -row["VRMAX"]
        notes.append(f"{where}: of {unit.name}: VRMAX is 0: taken as {row['VRMAX']:.4g}, VRMIN as its negative")


def import_case(raw: Path, dyr: Path | None = None) -> Imported:
    """A PSS/E case, checked as every system is, with notes for the user."""
    case, dynamics = read_raw(raw), None if dyr is None else read_dyr(dyr)
    try:
        imported = convert(case, dynamics, "" if dyr is None else dyr.name)
    except InputError as error:
        text = str(error)
        own = dyr is not None and text.startswith(f"{dyr.name}: ")
        raise InputError(f"{dyr}: {text.partition(': ')[2]}" if own else f"{raw}: {text}") from error
    check(System, imported.content, str(raw) if dyr is None else f"{raw} with {dyr}")
    return imported._replace(
        notes=[note if dyr and note.startswith(dyr.name) else f"{raw.name}: {note}" for note in imported.notes]
    )
