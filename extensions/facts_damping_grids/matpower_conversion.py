"""Conversion of the tables of a MATPOWER case to a system.

A case has no dynamic data. Machine rows come from a user's file; other machines have typical data.
"""

from __future__ import annotations

import math
import re
from itertools import count
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError, check_known
from facts_damping.parameters.field_errors import short
from facts_damping_grids.notes import Note, note_lines

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    Row = Mapping[str, float]
    Units = dict[int, list[tuple[int, Row]]]  # generators in service by bus, with their row numbers from 1
    Rows = list[dict[str, Any]]  # of a table of the system

REFERENCE, ISOLATED, PQ = 3, 4, 1  # bus types
LARGEST_RATING = 1e5  # MVA
# Kundur, Power System Stability and Control (1994), tables 3.2 and 4.2: within the ranges of thermal units.
TYPICAL = (
    {"model": "genrou", "H": 4.0, "Ra": 0.003, "Xl": 0.15}
    | {"Xd": 1.8, "Xd1": 0.3, "Xd2": 0.2, "Td01": 8.0, "Td02": 0.03}
    | {"Xq": 1.7, "Xq1": 0.55, "Xq2": 0.2, "Tq01": 1.0, "Tq02": 0.05}
)
FROM_CASE = ("bus", "generator", "P", "V", "slack", "angle")  # fields of a machine's row from the case
HEAD = ("name", "description", "frequency", "line_model", "step")
TABLES = ("infinite_buses", "exciters", "stabilisers", "governors", "devices", "pmus", "signals", "measures")


class MatpowerCase(NamedTuple):
    """The tables of a case as rows by MATPOWER's own column names (caseformat): MW, Mvar, p.u., degrees, kV."""

    name: str
    base_power: float
    bus: Sequence[Row]
    gen: Sequence[Row]
    branch: Sequence[Row]
    dc_lines: int = 0  # in service


class Imported(NamedTuple):
    """A system's content, the machines with typical data, and notes for the user."""

    content: dict[str, Any]
    typical: list[str]
    notes: list[str]


def convert(case: MatpowerCase, dynamics: Mapping[str, Any] | None = None) -> Imported:
    """A case as the content of a system's file; dynamics: machine rows by bus or generator, exciters and so on."""
    tables = dict(dynamics or {})
    for key in tables:
        check_known("--dynamics", key, ("machines", *HEAD, *TABLES))
    notes: list[str | Note] = []
    if case.dc_lines:
        notes.append(f"{case.dc_lines} DC lines are left out, and the power that they carry")
    buses = {_number(row["BUS_I"]): row for row in case.bus}
    _check_buses(case, buses)
    demand, units = _units(case, buses, notes)
    lines, transformers, charging = _branches(case, buses, notes)
    machines, typical = _machines(buses, units, tables.get("machines", []), notes)
    content: dict[str, Any] = {
        "name": system_name(case.name),
        "description": f"{case.name}, imported from MATPOWER",
        "base_power": case.base_power,
        "frequency": 60,
        "line_model": "pi",
        "buses": [{"name": f"B{n}", "nominal_voltage": row["BASE_KV"] or 1.0} for n, row in buses.items()],
        "lines": lines,
        "transformers": transformers,
        "loads": [{"name": f"load_{n}", "bus": f"B{n}", "P": p, "Q": q} for n, (p, q) in demand.items() if p or q],
        "shunts": [
            {"name": f"shunt_{n}", "bus": f"B{n}", "Q": row["BS"], "P": row["GS"]}
            for n, row in buses.items()
            if row["BS"] or row["GS"]
        ]
        + charging,
        "machines": machines,
        **measured([m["name"] for m in machines]),
    }
    if "signals" in tables or "pmus" in tables:
        content |= {"signals": {}, "measures": {}}  # the default ones refer to the default PMUs
    content |= {key: value for key, value in tables.items() if key != "machines"}
    return Imported(filled(content), typical, note_lines(notes))


# Common to both formats


def system_name(case: str) -> str:
    """A name for the system of a case."""
    return re.sub(r"[^A-Za-z0-9_.+-]", "_", case).lstrip("_.+-")[:64] or "case"


def measured(machines: Sequence[str], bus: str = "") -> dict[str, Any]:
    """A PMU at each machine, and the speed differences between the first one and the others.

    `bus`: where a PMU is if there is no machine.
    """
    if not machines:
        return {"pmus": [{"name": bus, "bus": bus}]}
    first = machines[0]
    pairs = {f"w_{first}_{other}": other for other in machines[1:]}
    return {
        "pmus": [{"name": name, "machine": name} for name in machines],
        "signals": {s: {"channel": "speed_deviation", "weights": {first: 1, o: -1}} for s, o in pairs.items()},
        "measures": {"local": list(pairs)},
    }


def filled(content: dict[str, Any]) -> dict[str, Any]:
    """The content of a system's file without empty tables."""
    return {key: value for key, value in content.items() if value not in ([], {})}


def without_data(typical: Sequence[str], machines: int) -> str:
    """The note on machines with typical data; `machines`: number of all machines."""
    which = "all machines" if len(typical) == machines else ", ".join(typical)
    return f"no dynamic data for {which}: typical data of synchronous machines (Kundur, table 4.2)"


def joined_to(bus: Any, branches: Iterable[tuple[Any, Any]]) -> set[Any]:
    """The buses connected to a bus by branches, including itself."""
    near: dict[Any, set[Any]] = {bus: set()}
    for first, other in branches:
        near.setdefault(first, set()).add(other)
        near.setdefault(other, set()).add(first)
    reached, edge = {bus}, {bus}
    while edge:
        edge = set().union(*(near[n] for n in edge)) - reached
        reached |= edge
    return reached


def some(buses: Sequence[int]) -> str:
    """The first few buses, for a message."""
    return ", ".join(map(str, buses[:5])) + (", ..." if len(buses) > 5 else "")


def _number(value: float) -> int:
    if value != int(value) or value < 1:
        raise InputError(f"bus number {value:g} given; allowed: a positive integer")
    return int(value)


def _check_buses(case: MatpowerCase, buses: Mapping[int, Row]) -> None:
    """Check that each bus is unique, that there is one reference, and that all buses are connected to it."""
    if len(buses) < len(case.bus):
        raise InputError(f"mpc.bus: {len(case.bus)} rows for {len(buses)} buses given; allowed: each bus once")
    reference = [n for n, row in buses.items() if row["BUS_TYPE"] == REFERENCE]
    if len(reference) != 1:
        raise InputError(f"mpc.bus: {len(reference)} reference buses (type 3) given; allowed: exactly one")
    joined = []
    for i, row in enumerate(case.branch, 1):
        ends = _number(row["F_BUS"]), _number(row["T_BUS"])
        for end in ends:
            if end not in buses:
                raise InputError(f"mpc.branch, row {i}: bus {end} given; allowed: a bus of mpc.bus")
        if row["BR_STATUS"] > 0:
            joined.append(ends)
    reached = joined_to(reference[0], joined)
    apart = [n for n, row in buses.items() if n not in reached or row["BUS_TYPE"] == ISOLATED]
    if apart:
        allowed = f"buses that branches in service join to bus {reference[0]}"
        raise InputError(f"mpc.bus: isolated buses given ({some(apart)}); allowed: {allowed}")


def _units(
    case: MatpowerCase, buses: Mapping[int, Row], notes: list[str | Note]
) -> tuple[dict[int, tuple[float, float]], Units]:
    """Demand by bus (MW, Mvar), and the generators in service."""
    demand = {n: (row["PD"], row["QD"]) for n, row in buses.items()}
    units: Units = {}
    for i, row in enumerate(case.gen, 1):
        n = _number(row["GEN_BUS"])
        if n not in buses:
            raise InputError(f"mpc.gen, row {i}: bus {n} given; allowed: a bus of mpc.bus")
        if row["GEN_STATUS"] <= 0:
            alone = f"generator {i} at bus {n} is out of service: left out"
            notes.append(Note(alone, "out of service: left out", "generators", str(i)))
        elif row["PMIN"] < 0 and row["PMAX"] == 0:
            alone = f"generator {i} at bus {n} is a dispatchable load: taken as a load"
            notes.append(Note(alone, "dispatchable loads are taken as loads", "generators", str(i)))
            demand[n] = demand[n][0] - row["PG"], demand[n][1] - row["QG"]
        else:
            units.setdefault(n, []).append((i, row))
    return demand, units


def _branches(case: MatpowerCase, buses: Mapping[int, Row], notes: list[str | Note]) -> tuple[Rows, Rows, Rows]:
    """Lines, transformers (with a ratio, a shift, or two nominal voltages), and shunts for transformers' charging."""
    lines, transformers, charging, names = [], [], [], set[str]()
    for i, row in enumerate(case.branch, 1):
        a, b = _number(row["F_BUS"]), _number(row["T_BUS"])
        if row["BR_STATUS"] <= 0:
            alone = f"branch {i} from bus {a} to bus {b} is out of service: left out"
            notes.append(Note(alone, "out of service: left out", "branches", str(i)))
            continue
        r, x, where = row["BR_R"], row["BR_X"], f"mpc.branch, row {i} ({a} to {b})"
        if r < 0:
            raise InputError(f"{where}: r = {r:g} given; allowed: 0 or more")
        if x == 0:
            raise InputError(f"{where}: x = {x:g} given; allowed: any but 0")
        line = not row["TAP"] and not row["SHIFT"] and buses[a]["BASE_KV"] == buses[b]["BASE_KV"] and row["BR_B"] >= 0
        stem = f"{'line_' if line else 'T'}{a}_{b}"
        numbered = (stem if number == 1 else f"{stem}_{number}" for number in count(1))
        name = next(name for name in numbered if name not in names)
        names.add(name)
        branch: dict[str, Any] = {"name": name, "from": f"B{a}", "to": f"B{b}"}
        if line:
            lines.append(branch | {"r": r, "x": x, "b": row["BR_B"]})
            continue
        tap = row["TAP"] or 1.0
        branch |= {"rating": case.base_power, "r": r, "x": x} | ({"tap": tap} if tap != 1 else {})
        transformers.append(branch | ({"phase_shift": row["SHIFT"]} if row["SHIFT"] else {}))
        if row["BR_B"]:
            half = row["BR_B"] / 2 * case.base_power
            for bus, Q in ((a, half / tap**2), (b, half)):
                charging.append({"name": f"charging_{name}_{bus}", "bus": f"B{bus}", "Q": Q})
            alone = f"branch {i} from bus {a} to bus {b}: its charging is two shunts, which stay when it opens"
            notes.append(Note(alone, "charging is two shunts, which stay when a branch opens", "branches", str(i)))
    return lines, transformers, charging


def _machines(buses: Mapping[int, Row], units: Units, rows: Any, notes: list[str | Note]) -> tuple[Rows, list[str]]:
    """Machines, one per bus, and the names of those with typical data."""
    dynamic_rows = _machine_rows(rows, units)
    if not units:
        raise InputError("mpc.gen: no generator in service given; allowed: at least one")
    machines, typical = [], []
    for n, here in sorted(units.items()):
        bus, members = buses[n], [row for _, row in here]
        if len(here) > 1:
            alone = f"generators {', '.join(str(i) for i, _ in here)} at bus {n} are joined into one machine"
            notes.append(Note(alone, "generators at one bus are joined into one machine", "buses", str(n)))
        P, Q = sum(row["PG"] for row in members), sum(row["QG"] for row in members)
        rating = sum(_rating(row) for row in members)
        V = members[-1]["VG"]
        if bus["BUS_TYPE"] == PQ:
            V = bus["VM"]
            alone = f"bus {n} has a generator but is of type 1: its machine holds {V:g} p.u., not {Q:g} Mvar"
            notes.append(Note(alone, "of type 1 with a generator: it holds the voltage, not Mvar", "buses", str(n)))
        slack = bus["BUS_TYPE"] == REFERENCE
        dispatch = {"slack": True, "angle": bus["VA"]} if slack else {"P": P}
        data = dynamic_rows.pop(n, None)
        name = (data or {}).get("name", f"G{n}")
        machine = {"name": name, "bus": f"B{n}", "rating": rating, "V": V} | dispatch
        machines.append(machine | (TYPICAL if data is None else {k: v for k, v in data.items() if k not in FROM_CASE}))
        if data is None:
            typical.append(name)
    if not any("slack" in m for m in machines):
        raise InputError("mpc.gen: no generator in service at the reference bus; allowed: at least one there")
    if typical:
        notes.append(f"{without_data(typical, len(machines))}, constant field voltage")
    return machines, typical


def _machine_rows(rows: Any, units: Units) -> dict[int, dict[str, Any]]:
    """Machine rows of the file of dynamics by bus number; each row names a `bus` (B30) or a `generator` (its row)."""
    rows_by_bus: dict[int, dict[str, Any]] = {}
    by_row = {i: n for n, here in units.items() for i, _ in here}
    by_bus = {f"B{n}": n for n in units}
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InputError(f"--dynamics: machines: {short(rows)} given; allowed: a list of rows")
    for i, row in enumerate(rows):
        where = f"--dynamics: machines.{i}"
        if ("bus" in row) == ("generator" in row):
            raise InputError(f"{where}: {short(row)} given; allowed: a row with either `bus` or `generator`")
        known: Mapping[Any, int] = by_bus if "bus" in row else by_row
        key = row.get("bus", row.get("generator"))
        if not isinstance(key, (str, int)) or key not in known:
            allowed = ", ".join(str(k) for k in known)
            raise InputError(f"{where}: {short(key)} given; allowed: {allowed}")
        for field in ("P", "V", "slack", "angle"):
            if field in row:
                raise InputError(f"{where}.{field}: {short(row[field])} given; allowed: none, the case says it")
        if known[key] in rows_by_bus:
            raise InputError(f"{where}: {short(key)} given; allowed: one row for the machine at bus {known[key]}")
        rows_by_bus[known[key]] = row
    return rows_by_bus


def _rating(row: Row) -> float:
    """Rated power, MVA: mBase; if the dispatch is larger (mBase left at the system base), Pmax or the dispatch."""
    dispatch = math.hypot(row["PG"], row["QG"])
    if row["MBASE"] >= dispatch and row["MBASE"] > 0:
        return row["MBASE"]
    return max(row["PMAX"], dispatch) if row["PMAX"] <= LARGEST_RATING else dispatch
