"""Conversion of PSS/E records (RAW, DYR) to a system.

References: PSS/E Program Operation Manual (power flow raw data), PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.plant.system import System
from facts_damping_grids import matpower_conversion, psse_dynamics, psse_units
from facts_damping_grids import psse_network as network
from facts_damping_grids.matpower_conversion import Imported
from facts_damping_grids.notes import Note, told
from facts_damping_grids.problems import CaseError, Problems, problems_of
from facts_damping_grids.psse_placing import placed
from facts_damping_grids.psse_reading import Row, read_dyr, read_raw

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping_grids.psse_reading import Dyr, RawCase

# Sections whose records affect the grid; the others do not.
ACTING = ("two-terminal dc", "VSC dc", "multi-terminal dc", "FACTS device", "GNE device", "induction machine")


def convert(case: RawCase, dyr: Dyr | None, dyr_name: str = "") -> Imported:
    """A case as the content of a system's file. Raises `CaseError` with the lines of all unsupported records."""
    notes: list[str | Note] = [
        f"{count} {section} records are left out" for section, count in case.unread.items() if section in ACTING
    ]
    problems = Problems()
    buses = network.buses(case, notes)
    units = psse_units.units(case, buses, notes)
    grid = _grid(case, buses, notes)
    slack = psse_units.slack_of(units, buses)
    _check_islands(buses, f"B{slack.bus}", [*grid["lines"], *grid["transformers"]])
    if dyr is None:
        dynamics = psse_dynamics.without(units)
        notes.append(matpower_conversion.without_data(dynamics.typical, len(units)))
    else:
        dynamics = psse_dynamics.read(case, units, dyr, dyr_name, notes, problems)
    problems.check()
    voltages = psse_units.held(units, buses, notes)
    terminals = psse_units.solved(grid, units, voltages, buses)
    rows = placed(units, dynamics, terminals, voltages, case, buses)
    content = grid | {
        **{table: [*grid.get(table, []), *more] for table, more in rows._asdict().items()},
        **dynamics.controls,
        **matpower_conversion.measured([m["name"] for m in rows.machines]),
    }
    return Imported(matpower_conversion.filled(content), dynamics.typical, told(notes))


def _grid(case: RawCase, buses: Mapping[int, Row], notes: list[str | Note]) -> dict[str, Any]:
    """The content of a system without units."""
    lines, shunts = network.lines(case, buses)
    transformers, stars, magnetising = network.transformers(case, buses, notes)
    return {
        "name": matpower_conversion.system_name(case.name),
        "description": f"{case.name}, imported from PSS/E",
        "base_power": case.base_power,
        "frequency": case.frequency,
        "line_model": "pi",
        "buses": [
            *({"name": f"B{n}", "nominal_voltage": row["BASKV"] or 1.0} for n, row in buses.items()),
            *({"name": star, "nominal_voltage": 1.0} for star in stars),
        ],
        "lines": lines,
        "transformers": transformers,
        "loads": network.loads(case, buses),
        "shunts": [*shunts, *magnetising, *network.shunts(case, buses)],
    }


def _check_islands(buses: Mapping[int, Row], slack: str, branches: Sequence[Row]) -> None:
    """Raise `InputError` if branches in service do not connect all buses to that of the slack machine."""
    reached = matpower_conversion.joined_to(slack, [(row["from"], row["to"]) for row in branches])
    apart = [n for n in buses if f"B{n}" not in reached]
    if apart:
        raise InputError(
            f"bus: an island without the slack machine given ({matpower_conversion.some(apart)}); allowed: one grid"
        )


def import_case(raw: Path, dyr: Path | None = None) -> Imported:
    """A PSS/E case as a validated system, with notes for the user. Raises `CaseError` with all that is wrong."""
    case, records = read_raw(raw), None if dyr is None else read_dyr(dyr)
    try:
        imported = convert(case, records, "" if dyr is None else dyr.name)
    except InputError as error:
        raise CaseError(_with_path(text, raw, dyr) for text in problems_of(error)) from error
    check(System, imported.content, str(raw) if dyr is None else f"{raw} with {dyr}")
    notes = [note if dyr and note.startswith(dyr.name) else f"{raw.name}: {note}" for note in imported.notes]
    return imported._replace(notes=notes)


def _with_path(text: str, raw: Path, dyr: Path | None) -> str:
    """A problem with the path of its file."""
    of_dyr = dyr is not None and text.startswith(f"{dyr.name}: ")
    return f"{dyr}: {text.partition(': ')[2]}" if of_dyr else f"{raw}: {text}"
