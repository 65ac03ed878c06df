"""RAW of version 23 as later versions have it.

There the record of a bus has its load and shunt, and a branch with a ratio or an angle is a transformer.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from facts_damping_grids.psse.records import Row


def modern(old: dict[str, list[Row]], base_power: float) -> dict[str, list[Row]]:
    """Tables with those of loads, shunts and transformers; `base_power` in MVA."""
    tables = {name: list(rows) for name, rows in old.items()}
    for bus in tables["bus"]:
        of_bus = {"I": bus["I"], "ID": "1", "STATUS": 1.0, "line": bus["line"]}
        tables["load"].append(of_bus | {"PL": bus["PL"], "QL": bus["QL"], "IP": 0.0, "IQ": 0.0, "YP": 0.0, "YQ": 0.0})
        tables["fixed shunt"].append(of_bus | {"GL": bus["GL"], "BL": bus["BL"]})
    tables["transformer"] = [_transformer(row) for row in tables["branch"] if row["RATIO"] or row["ANGLE"]]
    tables["fixed shunt"] += [shunt for row in tables["transformer"] for shunt in _charging(row, base_power)]
    tables["branch"] = [row for row in tables["branch"] if not (row["RATIO"] or row["ANGLE"])]
    return tables


def _transformer(branch: Row) -> Row:
    """A branch with a ratio, whose tap is at its first bus, with what later versions have beside."""
    windings = {"WINDV1": branch["RATIO"] or 1.0, "NOMV1": 0.0, "ANG1": branch["ANGLE"]}
    windings |= {"WINDV2": 1.0, "NOMV2": 0.0, "ANG2": 0.0}
    units = {"CW": 1.0, "CZ": 1.0, "CM": 1.0, "MAG1": 0.0, "MAG2": 0.0}
    impedance = {"STAT": branch["ST"], "R1": branch["R"], "X1": branch["X"], "S1": 0.0}
    return branch | units | windings | impedance | {"I": abs(branch["I"]), "J": abs(branch["J"]), "K": 0.0}


def _charging(row: Row, base_power: float) -> list[Row]:
    """The shunts of a transformer at its buses: its own, and its charging."""
    ends = (("I", row["GI"], row["BI"], row["WINDV1"]), ("J", row["GJ"], row["BJ"], 1.0))
    on = {"STATUS": row["ST"], "line": row["line"]}
    return [
        on
        | {"I": row[end], "ID": f"T{row['I']:g}_{row['J']:g}"}
        | {"GL": G * base_power, "BL": (B + row["B"] / 2.0 / ratio / ratio) * base_power}
        for end, G, B, ratio in ends
        if G or B or row["B"]
    ]
