"""Conversion of PSS/E records (RAW, DYR) to a system.

References: PSS/E Program Operation Manual (power flow raw data), PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.grid_formats import psse_network as network
from facts_damping.grid_formats.conversion import Imported, filled, joined_to, measured, some, system_name
from facts_damping.grid_formats.psse_files import read_dyr, read_raw
from facts_damping.grid_formats.psse_machines import machines_of, step_ups, units_of
from facts_damping.parameters.plant.system import System
from facts_damping.parameters.validation import check

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping.grid_formats.psse_files import Dyr, RawCase, Row

# Sections whose records affect the grid; the others do not.
ACTING = ("two-terminal dc", "VSC dc", "multi-terminal dc", "FACTS device", "GNE device", "induction machine")


def convert(case: RawCase, dynamics: Dyr | None, dynamics_name: str = "") -> Imported:
    """A case as the content of a system's file. Raises `InputError` with the line of an unsupported record."""
    notes = [f"{count} {section} records are left out" for section, count in case.unread.items() if section in ACTING]
    buses = network.buses(case, notes)
    units = units_of(case, buses, notes)
    lines, shunts = network.lines(case, buses)
    transformers, stars, magnetising = network.transformers(case, buses, notes)
    more, places = step_ups(case, units)
    transformers += more
    machines, controls, typical = machines_of(units, places, dynamics, dynamics_name, case, buses, notes)
    _check_islands(buses, [*lines, *transformers], machines)
    content: dict[str, Any] = {
        "name": system_name(case.name),
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
        "loads": network.loads(case, buses),
        "shunts": [*shunts, *magnetising, *network.shunts(case, buses)],
        "machines": machines,
        **controls,
        **measured([m["name"] for m in machines]),
    }
    return Imported(filled(content), typical, notes)


def _check_islands(buses: Mapping[int, Row], branches: Sequence[Row], machines: Sequence[Row]) -> None:
    """Raise `InputError` if branches in service do not connect all buses to the slack machine."""
    slack = next(m["bus"] for m in machines if m.get("slack"))
    reached = joined_to(slack, [(row["from"], row["to"]) for row in branches])
    apart = [n for n in buses if f"B{n}" not in reached]
    if apart:
        raise InputError(f"bus: an island without the slack machine given ({some(apart)}); allowed: one grid")


def import_case(raw: Path, dyr: Path | None = None) -> Imported:
    """A PSS/E case as a validated system, with notes for the user."""
    case, dynamics = read_raw(raw), None if dyr is None else read_dyr(dyr)
    try:
        imported = convert(case, dynamics, "" if dyr is None else dyr.name)
    except InputError as error:
        text = str(error)
        of_dyr = dyr is not None and text.startswith(f"{dyr.name}: ")
        raise InputError(f"{dyr}: {text.partition(': ')[2]}" if of_dyr else f"{raw}: {text}") from error
    check(System, imported.content, str(raw) if dyr is None else f"{raw} with {dyr}")
    notes = [note if dyr and note.startswith(dyr.name) else f"{raw.name}: {note}" for note in imported.notes]
    return imported._replace(notes=notes)
