"""The network of PSS/E records: buses, lines, transformers, loads and shunts, as rows of a system's tables."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError
from facts_damping_grids.matpower_conversion import ISOLATED
from facts_damping_grids.notes import Note
from facts_damping_grids.psse_reading import Row

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping_grids.psse_reading import RawCase


def buses(case: RawCase, notes: list[str | Note]) -> dict[int, Row]:
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


def bus_of(row: Row, bus_rows: Mapping[int, Row]) -> int | None:
    """The bus of a record; None if it is isolated or missing."""
    return int(row["I"]) if int(row["I"]) in bus_rows else None


def lines(case: RawCase, bus_rows: Mapping[int, Row]) -> tuple[list[Row], list[Row]]:
    """Lines in service, and the shunts at their ends."""
    lines, shunts, used = list[Row](), list[Row](), set[str]()
    for row in case.tables["branch"]:
        a, b = abs(int(row["I"])), abs(int(row["J"]))
        if row["ST"] != 1 or a not in bus_rows or b not in bus_rows:
            continue
        if row["X"] == 0.0 or a == b:
            what = f"X = {row['X']:g}" if a != b else f"bus {a} at both ends"
            raise InputError(f"line {row['line']}: branch: {what} given; allowed: two buses, X other than 0")
        name = _free(f"line_{a}_{b}", row["CKT"], used)
        lines.append({"name": name, "from": f"B{a}", "to": f"B{b}", "r": row["R"], "x": row["X"], "b": row["B"]})
        for bus, G, B in ((a, row["GI"], row["BI"]), (b, row["GJ"], row["BJ"])):
            if G or B:
                shunts.append(_shunt(f"shunt_{name}_{bus}", bus, G, B, case))
    return lines, shunts


def _shunt(name: str, bus: int, G: float, B: float, case: RawCase) -> Row:
    """A shunt of the system, from admittances in p.u."""
    return {"name": name, "bus": f"B{bus}", "Q": B * case.base_power, "P": G * case.base_power}


def _free(stem: str, circuit: str, used: set[str]) -> str:
    """A name that is not used: with its circuit if that is not the first."""
    mark = re.sub(r"[^A-Za-z0-9]", "", str(circuit))
    name = stem if mark in ("", "1") else f"{stem}_{mark}"
    while name in used:
        name += "x"
    used.add(name)
    return name


def loads(case: RawCase, bus_rows: Mapping[int, Row]) -> list[Row]:
    """Loads: constant power in the power flow and impedances in the dynamics, as our loads are."""
    loads = []
    for row in case.tables["load"]:
        n = bus_of(row, bus_rows)
        if n is None or row["STATUS"] != 1:
            continue
        stem = f"load_{n}" if row["ID"] in ("1", "") else f"load_{n}_{row['ID']}"
        fractions = {"P_fractions": {"current": 1}, "Q_fractions": {"current": 1}, "at": "nominal"}
        parts: Any = (
            ("", row["PL"], row["QL"], {}),
            ("_current", row["IP"], row["IQ"], fractions),
            ("_impedance", row["YP"], -row["YQ"], {"at": "nominal"}),
        )
        loads += [{"name": stem + end, "bus": f"B{n}", "P": P, "Q": Q} | more for end, P, Q, more in parts if P or Q]
    return loads


def shunts(case: RawCase, bus_rows: Mapping[int, Row]) -> list[Row]:
    """Fixed shunts, and switched shunts in their present state."""
    rows = []
    for section, G, B, on in (("fixed shunt", "GL", "BL", "STATUS"), ("switched shunt", None, "BINIT", "ST")):
        used = set[str]()
        for row in case.tables[section]:
            n = bus_of(row, bus_rows)
            if n is None or row[on] != 1 or not (row[B] or (G and row[G])):
                continue
            name = _free(f"{section.split()[0]}_{n}", row.get("ID", "1"), used)
            rows.append({"name": name, "bus": f"B{n}", "Q": row[B], "P": row[G] if G else 0.0})
    return rows


# Transformers


class Winding(NamedTuple):
    """A winding: its bus, the ratio of its voltage to that of the bus (p.u.), and its angle (deg)."""

    bus: int
    ratio: float
    angle: float


def _winding(row: Row, number: int, end: str, bus_rows: Mapping[int, Row]) -> Winding:
    """A winding of a transformer; CW: 1: p.u. of the bus, 2: kV, 3: p.u. of the winding's nominal voltage."""
    n, value = int(row[end]), row[f"WINDV{number}"]
    base, nominal = bus_rows[n]["BASKV"] or 1.0, row[f"NOMV{number}"]
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


def transformers(
    case: RawCase, bus_rows: Mapping[int, Row], notes: list[str | Note]
) -> tuple[list[Row], list[str], list[Row]]:
    """Two-winding transformers, three-winding ones as stars, the buses of the stars, and magnetising shunts."""
    rows, stars, shunts, used = list[Row](), list[str](), list[Row](), set[str]()
    for row in case.tables["transformer"]:
        ends = [end for end in ("I", "J", "K") if row[end]]
        if row["STAT"] == 0 or any(int(row[end]) not in bus_rows for end in ends):
            continue
        windings = [_winding(row, i, end, bus_rows) for i, end in enumerate(ends, 1)]
        name = _free("T" + "_".join(str(int(row[end])) for end in ends), row["CKT"], used)
        for w in windings:
            if not 0.5 < w.ratio < 2.0:
                raise InputError(f"line {row['line']}: transformer: ratio {w.ratio:g} given; allowed: 0.5 to 2")
        z = [_impedance(row, i, case.base_power) for i in range(1, 2 if len(ends) == 2 else 4)]
        if len(ends) == 2:
            first, second = windings
            turn = first.angle - second.angle
            rows.append(_two_windings(name, first, turn, f"B{second.bus}", second.ratio, z[0], row, case))
        else:
            star = f"{name}_star"
            stars.append(star)
            arms = [(z[0] + z[2] - z[1]) / 2, (z[0] + z[1] - z[2]) / 2, (z[1] + z[2] - z[0]) / 2]
            out = {2: 1, 3: 2, 4: 0}.get(int(row["STAT"]))
            for i, (w, arm) in enumerate(zip(windings, arms, strict=True)):
                if i != out:
                    rows.append(_two_windings(f"{name}_{i + 1}", w, w.angle, star, 1.0, arm, row, case))
        shunts += _magnetising(row, windings[0].bus, name, case, notes)
    return rows, stars, shunts


def _two_windings(
    name: str, first: Winding, turn: float, end: str, second: float, z: complex, row: Row, case: RawCase
) -> Row:
    """A transformer of the system: its tap and phase shift at the first bus, its impedance at the second."""
    z *= second * second
    if z.imag == 0.0:
        raise InputError(f"line {row['line']}: transformer: X = 0 given; allowed: another value")
    tap, ends = first.ratio / second, {"from": f"B{first.bus}", "to": end}
    values = {"name": name, **ends, "rating": case.base_power, "r": z.real, "x": z.imag}
    return values | ({"tap": tap} if tap != 1.0 else {}) | ({"phase_shift": turn} if turn else {})


def _magnetising(row: Row, bus: int, name: str, case: RawCase, notes: list[str | Note]) -> list[Row]:
    """The magnetising branch as a shunt at the first bus; CM: 1: G and B of the system base, 2: W and p.u. current."""
    G, B = row["MAG1"], row["MAG2"]
    if not (G or B):
        return []
    if row["CM"] == 2:
        rating = row["S1"] or case.base_power
        G, current = G / 1e6 / case.base_power, B * rating / case.base_power
        B = -math.sqrt(max(0.0, current * current - G * G))
    alone = f"line {row['line']}: the magnetising branch of {name} is a shunt, which stays when it opens"
    notes.append(Note(alone, "magnetising branches are shunts, which stay when it opens", "transformers", name))
    return [_shunt(f"magnetising_{name}", bus, G, B, case)]
