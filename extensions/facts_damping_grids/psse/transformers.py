"""Transformers of PSS/E records: of two windings, and of three as stars, with magnetising branches as shunts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from facts_damping_grids.notes import Note
from facts_damping_grids.psse.loads import free_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping_grids.psse.reading import RawCase
    from facts_damping_grids.psse.records import Row

ZERO = 1e-5  # p.u., reactance that stands for none: a tenth of PSS/E's threshold, which a power flow still resolves


class Transformers(NamedTuple):
    """Rows of transformers, the names of the star points, and shunts of magnetising branches."""

    rows: list[Row]
    stars: list[str]
    shunts: list[Row]


class _Winding(NamedTuple):
    """A winding: its bus, the ratio of its voltage to that of the bus (p.u.), and its angle (deg)."""

    bus: int
    ratio: float
    angle: float


def transformers(case: RawCase, buses: Mapping[int, Row], notes: list[str | Note], problems: list[str]) -> Transformers:
    """Transformers in service; a ratio of 0 and a rating of 0 that is a base are problems."""
    table, used = Transformers([], [], []), set[str]()
    for record in case.tables["transformer"]:
        ends = [end for end in ("I", "J", "K") if record[end]]
        out = {2: "J", 3: "K", 4: "I"}.get(record["STAT"]) if len(ends) == 3 else None
        joined = [end for end in ends if abs(int(record[end])) in buses and end != out]
        if record["STAT"] == 0 or len(joined) < 2:
            continue
        bad = _problems(record, ends)
        if bad:
            problems += [f"{case.where('transformer', record)}: {problem}" for problem in bad]
            continue
        name = free_name("T" + "_".join(str(abs(int(record[end]))) for end in ends), record["CKT"], used)
        windings = {end: _winding(record, i, end, buses) for i, end in enumerate(ends, 1) if end in joined}
        z = [_impedance(record, i, case.base_power) for i in range(1, 2 if len(ends) == 2 else 4)]
        if len(ends) == 2:
            first, second = windings.values()
            turn, end = first.angle - second.angle, f"B{second.bus}"
            table.rows.append(_two_windings(name, first, turn, end, second.ratio, z[0], case, notes))
        else:
            star = f"{name}_star"
            table.stars.append(star)
            arms = [(z[0] + z[2] - z[1]) / 2, (z[0] + z[1] - z[2]) / 2, (z[1] + z[2] - z[0]) / 2]
            for i, (end, arm) in enumerate(zip(ends, arms, strict=True), 1):
                if end in joined:
                    w = windings[end]
                    table.rows.append(_two_windings(f"{name}_{i}", w, w.angle, star, 1.0, arm, case, notes))
        if "I" in joined:
            table.shunts.extend(_magnetising(record, buses[windings["I"].bus], name, case, notes))
    return table


def _problems(record: Row, ends: list[str]) -> list[str]:
    """What no equation can be made of."""
    ratios = [f"WINDV{i}" for i in range(1, len(ends) + 1)]
    problems = [f"{name} = {record[name]:g} given; allowed: more than 0" for name in ratios if record[name] <= 0.0]
    if len({abs(record[end]) for end in ends}) < len(ends):
        problems.append(f"buses {', '.join(f'{record[end]:g}' for end in ends)} given; allowed: different ones")
    for i in range(1, 2 if len(ends) == 2 else 4):
        rating = record[f"S{i}"]
        if record["CZ"] != 1 and rating <= 0.0:
            problems += [f"SBASE{i} = {rating:g} given; allowed: more than 0, the base of its impedance"]
    return problems


def _winding(record: Row, number: int, end: str, buses: Mapping[int, Row]) -> _Winding:
    """A winding of a transformer; CW: 1: p.u. of the bus, 2: kV, 3: p.u. of the winding's nominal voltage."""
    n, value = abs(int(record[end])), record[f"WINDV{number}"]
    base, nominal = buses[n]["BASKV"] or 1.0, record[f"NOMV{number}"]
    if record["CW"] == 2:
        value /= base
    elif record["CW"] == 3 and nominal:
        value *= nominal / base
    return _Winding(n, value, record[f"ANG{number}"])


def _impedance(record: Row, number: int, base_power: float) -> complex:
    """R + j X of a pair of windings, p.u. of the system base.

    CZ: 1: p.u. of the system base, 2: of the pair's rating, 3: load loss (W) and |Z| of the rating.
    """
    r, x, rating = (float(record[f"{name}{number}"]) for name in ("R", "X", "S"))
    if record["CZ"] == 1:
        return complex(r, x)
    if record["CZ"] == 3:
        r = r / 1e6 / rating
        x = math.sqrt(max(0.0, x * x - r * r))
    return complex(r, x) * base_power / rating


def _two_windings(
    name: str, first: _Winding, turn: float, end: str, second: float, z: complex, case: RawCase, notes: list[str | Note]
) -> Row:
    """A transformer of the system: its tap and phase shift at the first bus, its impedance at the second."""
    z *= second * second
    if abs(z.imag) < ZERO:
        alone = f"{name}: a reactance of {ZERO:g} p.u. stands for X = {z.imag:g}"
        common = f"transformers with X = 0: a reactance of {ZERO:g} p.u. stands for it"
        notes.append(Note(alone, common, "transformers", name))
        z = complex(z.real, ZERO)
    tap, ends = first.ratio / second, {"from": f"B{first.bus}", "to": end}
    values = {"name": name, **ends, "rating": case.base_power, "r": z.real, "x": z.imag}
    turn = (turn + 180.0) % 360.0 - 180.0 if abs(turn) > 180.0 else turn
    return values | ({"tap": tap} if tap != 1.0 else {}) | ({"phase_shift": turn} if turn else {})


def shunt(name: str, bus: int, G: float, B: float, case: RawCase) -> Row:
    """A shunt of the system, from admittances in p.u."""
    return {"name": name, "bus": f"B{bus}", "Q": B * case.base_power, "P": G * case.base_power}


def _magnetising(record: Row, bus: Row, name: str, case: RawCase, notes: list[str | Note]) -> list[Row]:
    """The magnetising branch as a shunt at the first bus.

    CM: 1: G and B of the system base, 2: W and p.u. current, of the rating and the winding's nominal voltage.
    """
    G, B = record["MAG1"], record["MAG2"]
    if not (G or B):
        return []
    if record["CM"] == 2:
        G, current = G / 1e6, B * (record["S1"] or case.base_power)
        turns = bus["BASKV"] / record["NOMV1"] if bus["BASKV"] and record["NOMV1"] else 1.0
        G, B = (turns * turns * part / case.base_power for part in (G, -math.sqrt(max(0.0, current * current - G * G))))
    alone = f"line {record['line']}: the magnetising branch of {name} is a shunt, which stays when it opens"
    common, effect = "magnetising branches are shunts, which stay when it opens", "its magnetising branch stays"
    notes.append(Note(alone, common, "transformers", name, "transformer", "replaced", f"{effect} when it opens"))
    return [shunt(f"magnetising_{name}", int(bus["I"]), G, B, case)]
