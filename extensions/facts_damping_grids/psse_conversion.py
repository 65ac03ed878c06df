"""Conversion of PSS/E records (RAW, DYR) to a system.

References: PSS/E Program Operation Manual (power flow raw data), PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError, ProblemsError
from facts_damping_grids import matpower_conversion, psse_dynamics, psse_units, report
from facts_damping_grids import psse_network as network
from facts_damping_grids.control_limits import widened
from facts_damping_grids.notes import Note, told
from facts_damping_grids.problems import Problems, problems_of
from facts_damping_grids.psse_checking import checked
from facts_damping_grids.psse_placing import placed
from facts_damping_grids.psse_reading import Row, read_dyr, read_raw
from facts_damping_grids.report import ACTING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping_grids.psse_dynamics import Dynamics
    from facts_damping_grids.psse_reading import Dyr, RawCase

LEFT_OUT = {  # what can be otherwise without the records of a section
    "FACTS device": "its control of voltage and power is missing",
    "induction machine": "the power that it draws is missing, and its motion",
}
DC = "the power that it carries is missing, and what it draws at its ends"
TYPICAL_DATA = "swings, voltages and frequency are those of other machines"


class Converted(NamedTuple):
    """A system's content, its dynamics, and all notes."""

    content: dict[str, Any]
    dynamics: Dynamics
    notes: list[str | Note]


def convert(case: RawCase, dyr: Dyr | None, dyr_name: str = "") -> Converted:
    """A case as the content of a system's file. Raises `ProblemsError` with the lines of all unsupported records."""
    notes: list[str | Note] = _sections_left_out(case)
    problems = Problems()
    buses = network.buses(case, notes)
    units = psse_units.units(case, buses)
    with problems.collected():
        grid = _grid(case, buses, notes)
        slack = psse_units.slack_of(units, buses)
        _check_islands(buses, f"B{slack.bus}", [*grid["lines"], *grid["transformers"]])
    if dyr is None:
        dynamics = psse_dynamics.without(units)
        notes += [_typical(unit) for unit in units]
    else:
        dynamics = psse_dynamics.read(case, units, dyr, dyr_name, notes, problems)
    problems.check()
    voltages = psse_units.held(units, buses, notes)
    terminals, solution = psse_units.solved(grid, units, voltages, buses)
    rows = placed(units, dynamics, terminals, voltages, case, buses)
    content = matpower_conversion.filled(
        {
            **grid,
            **{table: [*grid.get(table, []), *more] for table, more in rows._asdict().items()},
            **dynamics.controls,
            **matpower_conversion.measured([m["name"] for m in rows.machines]),
        }
    )
    content, unusual = checked(content, dynamics.origins, problems)
    problems.check()
    content, wider = widened(content, dynamics.origins)
    return Converted(content, dynamics, [*notes, *unusual, *wider, psse_units.mismatch(buses, solution)])


def _sections_left_out(case: RawCase) -> list[str | Note]:
    """Notes on records of sections that affect the grid and are not read."""
    return [
        Note(
            *(f"a {section} record is left out", f"{section}: left out", "records", str(i)),
            *(section, "left out", LEFT_OUT.get(section, DC)),
        )
        for section in ACTING
        for i in range(case.unread.get(section, 0))
    ]


def _typical(unit: psse_units.Unit) -> Note:
    """The note on a machine of a case without DYR file."""
    common = "generator: no dynamic data: typical data of synchronous machines (Kundur, table 4.2)"
    alone = f"line {unit.row['line']}: {common}"
    return Note(alone, common, "machines", unit.name, "generator", "replaced", TYPICAL_DATA)


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


class ImportedCase(NamedTuple):
    """A system's content, the machines with typical data, notes for the user, and what became of the records.

    `inexact`: all that is replaced or left out, with file and line.
    """

    content: dict[str, Any]
    typical: list[str]
    notes: list[str]
    records: list[report.Records]
    inexact: list[str]


def import_case(raw: Path, dyr: Path | None = None) -> ImportedCase:
    """A PSS/E case as a validated system that has a rest. Raises `ProblemsError` with all that is wrong."""
    case, records = read_raw(raw), None if dyr is None else read_dyr(dyr)
    dyr_name = "" if dyr is None else dyr.name
    try:
        content, dynamics, notes = convert(case, records, dyr_name)
    except InputError as error:
        lines = problems_of(error)
        raise ProblemsError([_with_path(text, raw, dyr) for text in lines], most=len(lines)) from error
    inexact = [note.alone for note in notes if isinstance(note, Note) and note.outcome in ("replaced", "left out")]
    named = [
        [text if dyr and text.startswith(f"{dyr_name}: ") else f"{raw.name}: {text}" for text in texts]
        for texts in (told(notes), inexact)
    ]
    return ImportedCase(content, dynamics.typical, named[0], report.of_case(case, records, notes), named[1])


def _with_path(text: str, raw: Path, dyr: Path | None) -> str:
    """A problem with the path of its file."""
    of_dyr = dyr is not None and text.startswith(f"{dyr.name}: ")
    return f"{dyr}: {text.partition(': ')[2]}" if of_dyr else f"{raw}: {text}"
