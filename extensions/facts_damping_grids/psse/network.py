"""The network of PSS/E records: buses, lines, transformers, loads and shunts, as rows of a system's tables.

What no equation can be made of is collected as problems, each with file and line.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.numerics.matrices import parts
from facts_damping.output.tables import some_of
from facts_damping_grids.matpower_conversion import ISOLATED, PQ, REFERENCE
from facts_damping_grids.notes import Note
from facts_damping_grids.psse.loads import LoadModel, free_name, loads
from facts_damping_grids.psse.records import KEYS, Row
from facts_damping_grids.psse.transformers import ZERO, shunt, transformers

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from facts_damping_grids.psse.reading import RawCase

LIMIT = 1e-3  # Mvar, closeness to a limit of reactive power, to which a RAW file rounds it


class Network(NamedTuple):
    """Buses in service by their numbers, names of star points, and rows of the system's tables."""

    buses: dict[int, Row]
    stars: list[str]
    lines: list[Row]
    transformers: list[Row]
    loads: list[Row]
    shunts: list[Row]


def network(case: RawCase, model: LoadModel, notes: list[str | Note], problems: list[str]) -> Network:
    """The network of a case; `model`: of loads of constant power.

    Problems: unknown buses, X = 0 in a branch with resistance, a ratio of 0, an island with generators and no bus of
    type 3. Islands without a generator in service are left out, and of several islands all but the largest one.
    """
    buses = _buses(case, notes, problems)
    _check_buses(case, problems)
    lines, at_ends = _lines(case, buses, notes, problems)
    rows, stars, magnetising = transformers(case, buses, notes, problems)
    joined = [(row["from"], row["to"]) for row in (*lines, *rows)]
    out = set[str]() if problems else _left_out(case, buses, stars, joined, notes, problems)
    buses = {n: row for n, row in buses.items() if f"B{n}" not in out}
    return Network(
        buses,
        [star for star in stars if star not in out],
        [row for row in lines if row["from"] not in out],
        [row for row in rows if row["from"] not in out],
        loads(case, buses, model, notes, problems),
        [row for row in (*at_ends, *magnetising, *_shunts(case, buses)) if row["bus"] not in out],
    )


def bus_of(record: Row, buses: Mapping[int, Row]) -> int | None:
    """The bus of a record; None if it is isolated."""
    return int(record["I"]) if int(record["I"]) in buses else None


def holds_voltage(generator: Row, bus: Row) -> bool:
    """Whether a generator holds VS at its bus; else that has the voltage VM of the solved case.

    It does not at a bus of type 1, as regulator of another bus, and where its reactive power is at a limit that keeps
    the voltage below or above VS.
    """
    elsewhere = generator["IREG"] not in (0.0, generator["I"])
    beyond = bus["VM"] - generator["VS"]
    limited = (beyond < 0.0 and generator["QG"] > generator["QT"] - LIMIT) or (
        beyond > 0.0 and generator["QG"] < generator["QB"] + LIMIT
    )
    return bus["IDE"] != PQ and not elsewhere and (bus["IDE"] == REFERENCE or not limited)


def _buses(case: RawCase, notes: list[str | Note], problems: list[str]) -> dict[int, Row]:
    """Buses in service by their numbers."""
    buses: dict[int, Row] = {}
    for record in case.tables["bus"]:
        n = int(record["I"])
        if n in buses:
            problems.append(f"{case.where('bus', record)}: {n} stands twice; allowed: each bus once")
        buses[n] = record
    out = [str(n) for n, record in buses.items() if record["IDE"] == ISOLATED]
    if out:
        notes.append(f"isolated buses are left out: {some_of(out)}")
    return {n: record for n, record in buses.items() if record["IDE"] != ISOLATED}


def _check_buses(case: RawCase, problems: list[str]) -> None:
    """Whether all records name buses that are there."""
    known = {int(record["I"]) for record in case.tables["bus"]} | {0}
    for section, records in case.tables.items():
        for record in records:
            for key in KEYS & record.keys():
                n = record[key]
                if abs(int(n)) not in known or (n == 0.0 and key != "K"):
                    problems.append(f"{case.where(section, record)}: {key} = {n:g} given; allowed: a bus")


def branch_between(grid: Network, first: int, second: int, circuit: str) -> str | None:
    """The name of the line, switch or transformer of two windings between buses; None: there is none in service."""
    mark = re.sub(r"[^A-Za-z0-9]", "", circuit)
    for row in (*grid.lines, *grid.transformers):
        ends = [row["from"], row["to"]]
        if set(ends) == {f"B{first}", f"B{second}"}:
            stem = "_".join(end[1:] for end in ends)
            _, _, rest = str(row["name"]).partition(stem)
            if rest.lstrip("_") == ("" if mark == "1" else mark):
                return str(row["name"])
    return None


# Lines and shunts


def _joins(record: Row, case: RawCase) -> bool:
    """Whether a branch or a switch is a zero-impedance line: its buses are one."""
    return bool(record.get("R", 0.0) == 0.0 and abs(record["X"]) <= case.threshold)


def one_voltage(case: RawCase, notes: list[str | Note]) -> RawCase:
    """A case in which generators at buses that zero-impedance lines make one hold one voltage.

    It is that of a bus of type 3 among them, else of the first one.
    """
    records = [row for section in ("branch", "switching device") for row in case.tables[section] if row["ST"] == 1]
    joined = [(f"{abs(row['I']):g}", f"{abs(row['J']):g}") for row in records if _joins(row, case)]
    ends = dict.fromkeys(bus for pair in joined for bus in pair)
    number = {float(bus): i for i, island in enumerate(_islands(ends, joined)) for bus in island}
    buses = {row["I"]: row for row in case.tables["bus"] if row["I"] in number}
    generators = list(case.tables["generator"])
    holding = [i for i, row in enumerate(generators) if row["I"] in buses and row["STAT"] == 1]
    holding = [i for i in holding if holds_voltage(generators[i], buses[generators[i]["I"]])]
    first: dict[int, Row] = {}
    for i in sorted(holding, key=lambda i: bool(buses[generators[i]["I"]]["IDE"] != REFERENCE)):
        row = generators[i]
        leading = first.setdefault(number[row["I"]], row)
        if leading["VS"] != row["VS"]:
            alone = f"bus {row['I']:g} has the voltage of bus {leading['I']:g}, to which it is joined without impedance"
            common = "have the voltage of a bus to which they are joined without impedance"
            notes.append(Note(alone, common, "buses", f"{row['I']:g}"))
            generators[i] = row | {"VS": leading["VS"]}
    return case._replace(tables=case.tables | {"generator": generators})


def _lines(
    case: RawCase, buses: Mapping[int, Row], notes: list[str | Note], problems: list[str]
) -> tuple[list[Row], list[Row]]:
    """Lines and closed switches in service, and the shunts at the ends of lines.

    A zero-impedance line is a small reactance: so its buses keep their names, and it may be opened.
    """
    lines, shunts, used = list[Row](), list[Row](), set[str]()
    for section in ("branch", "switching device"):
        for record in case.tables[section]:
            a, b, r, x = abs(int(record["I"])), abs(int(record["J"])), record.get("R", 0.0), record["X"]
            if record["ST"] != 1 or a not in buses or b not in buses:
                continue
            joins = _joins(record, case)
            if a == b or (x == 0.0 and not joins):
                what = f"bus {a} at both ends" if a == b else f"X = 0 with R = {r:g}"
                allowed = "two buses, X other than 0, or R and X of 0 for a zero-impedance line"
                problems.append(f"{case.where(section, record)}: {what} given; allowed: {allowed}")
                continue
            name = free_name(f"{'line' if section == 'branch' else 'switch'}_{a}_{b}", record["CKT"], used)
            if joins:
                common = f"zero-impedance lines: a reactance of {ZERO:g} p.u. stands for it"
                notes.append(
                    Note(f"{name}: zero impedance: a reactance of {ZERO:g} p.u. stands for it", common, "lines", name)
                )
            ends = {"name": name, "from": f"B{a}", "to": f"B{b}"}
            lines.append(ends | {"r": r, "x": ZERO if joins else x, "b": record.get("B", 0.0)})
            for bus, G, B in ((a, record.get("GI"), record.get("BI")), (b, record.get("GJ"), record.get("BJ"))):
                if G or B:
                    shunts.append(shunt(f"shunt_{name}_{bus}", bus, G or 0.0, B or 0.0, case))
    return lines, shunts


def _shunts(case: RawCase, buses: Mapping[int, Row]) -> list[Row]:
    """Fixed shunts, and switched shunts in their present state."""
    rows = []
    for section, G, B, on in (("fixed shunt", "GL", "BL", "STATUS"), ("switched shunt", "", "BINIT", "ST")):
        used = set[str]()
        for record in case.tables[section]:
            n = bus_of(record, buses)
            if n is None or record.get(on, 1) != 1 or not (record[B] or record.get(G)):
                continue
            name = free_name(f"{section.split()[0]}_{n}", record.get("ID", "1"), used)
            rows.append({"name": name, "bus": f"B{n}", "Q": record[B], "P": record.get(G, 0.0)})
    return rows


# Islands


def _left_out(
    case: RawCase,
    buses: Mapping[int, Row],
    stars: Iterable[str],
    joined: Iterable[tuple[str, str]],
    notes: list[str | Note],
    problems: list[str],
) -> set[str]:
    """Buses of the islands that are left out."""
    fed = {f"B{int(g['I'])}" for g in case.tables["generator"] if g["STAT"] == 1 and int(g["I"]) in buses}
    swing = {bus for bus in fed if buses[int(bus[1:])]["IDE"] == REFERENCE}
    islands = _islands([*(f"B{n}" for n in buses), *stars], joined)
    with_swing = [island for island in islands if island.keys() & swing]
    if not with_swing:
        return set()  # which a system of one island without swing bus is refused for
    largest = max(with_swing, key=len)
    out = set[str]()
    for island in islands:
        if island is largest:
            continue
        numbers = [bus[1:] for bus in island if bus[0] == "B"]
        if island.keys() & swing or not island.keys() & fed:
            notes += [_island_note(buses[int(n)], dead=not island.keys() & fed) for n in numbers]
            out |= island.keys()
        else:
            problem = f"an island with generators and no bus of type 3 given ({some_of(numbers, 5)})"
            problems.append(f"{case.source}: bus: {problem}; allowed: such a bus in each island")
    return out


def _island_note(record: Row, *, dead: bool) -> Note:
    """The note on a bus of an island that is left out: `dead` as in PSS/E, or a grid of its own."""
    why = "of an island without a generator in service" if dead else "of an island beside the largest one"
    bus = f"{int(record['I'])}"
    alone, common = f"line {record['line']}: bus: {bus}: {why}: left out", f"{why}: left out"
    if dead:
        return Note(alone, common, "buses", bus)
    return Note(alone, common, "buses", bus, "bus", "left out", "all that is in that island is missing")


def _islands(names: Iterable[str], joined: Iterable[tuple[str, str]]) -> list[dict[str, None]]:
    """The buses that branches join, in the order of the names."""
    index = {name: i for i, name in enumerate(names)}
    islands: dict[int, dict[str, None]] = {}
    for name, number in zip(index, parts(len(index), ((index[a], index[b]) for a, b in joined)), strict=True):
        islands.setdefault(number, {})[name] = None
    return list(islands.values())
