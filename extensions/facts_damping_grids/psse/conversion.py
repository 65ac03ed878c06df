"""Conversion of PSS/E records (RAW, DYR) to a system.

References: PSS/E Program Operation Manual (power flow raw data), PSS/E Model Library (DYR records).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError, ProblemsError
from facts_damping.parameters.plant.system import System
from facts_damping.plant.grid.power_flow import solve
from facts_damping_grids import matpower_conversion
from facts_damping_grids.control_limits import widened
from facts_damping_grids.notes import Note, note_lines
from facts_damping_grids.problems import Problems, problems_of
from facts_damping_grids.psse import generators, network, report
from facts_damping_grids.psse.checking import check_possible, checked
from facts_damping_grids.psse.dynamics import dynamics_of, typical_dynamics
from facts_damping_grids.psse.loads import IMPEDANCE
from facts_damping_grids.psse.placing import placed
from facts_damping_grids.psse.reading import read_dyr, read_raw
from facts_damping_grids.psse.report import ACTING

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping_grids.psse.dynamics import Dynamics
    from facts_damping_grids.psse.loads import LoadModel
    from facts_damping_grids.psse.reading import Dyr, RawCase

LEFT_OUT = {  # what can be otherwise without the records of a section
    "FACTS device": "its control of voltage and power is missing",
    "induction machine": "the power that it draws is missing, and its motion",
    "impedance correction": "transformers with a table have the impedance of their record at any tap",
}
DC = "the power that it carries is missing, and what it draws at its ends"
TYPICAL_DATA = "swings, voltages and frequency are those of other machines"


class Converted(NamedTuple):
    """A system's content, its dynamics, and all notes."""

    content: dict[str, Any]
    dynamics: Dynamics
    notes: list[str | Note]


def convert(
    case: RawCase,
    dyr: Dyr | None,
    dyr_name: str = "",
    *,
    load_model: LoadModel = IMPEDANCE,
    problems: Problems | None = None,
) -> Converted:
    """A case as the content of a system's file, at rest; `problems`: those of its files.

    Raises `ProblemsError` with all problems of files and records.
    """
    problems = problems or Problems()
    notes: list[str | Note] = _sections_left_out(case)
    grid = network.network(case, load_model, notes, problems.lines)
    case = network.one_voltage(case, notes)
    units = generators.units(case, grid.buses, notes, problems)
    voltages = generators.held(units, grid.buses, notes)
    without_units, at_buses = _without_units(case, grid), dict[str, Any]()
    origins = {("generator", unit.name): f"line {unit.row['line']}: generator: {unit.name}" for unit in units}
    if not problems.lines:
        at_buses = generators.at_buses(without_units, units, voltages, grid.buses)
        check_possible(at_buses, origins, problems)
    if dyr is None:
        dynamics = typical_dynamics(units)
        notes += [_typical(unit) for unit in units]
    else:
        dynamics = dynamics_of(case, grid, units, dyr, dyr_name, notes, problems)
    problems.check()
    flow = solve(System.model_validate(at_buses))
    rows = placed(units, dynamics, generators.terminals(flow, units), voltages, case, grid.buses, notes)
    content = matpower_conversion.filled(
        {
            **without_units,
            **{table: [*without_units.get(table, []), *more] for table, more in rows._asdict().items()},
            **dynamics.controls,
            **matpower_conversion.measured([m["name"] for m in rows.machines], f"B{units[0].bus}"),
        }
    )
    content, unusual = checked(content, origins | dynamics.origins, problems)
    problems.check()
    content, wider = widened(content, dynamics.origins)
    return Converted(content, dynamics, [*notes, *unusual, *wider, generators.mismatch(grid.buses, flow.by_bus)])


def _sections_left_out(case: RawCase) -> list[str | Note]:
    """Notes on records of sections that affect the grid and are not read."""
    return [
        Note(
            *(f"line {line}: {section}: is not modelled: left out", f"{section}: left out", "lines", str(line)),
            *(section, "left out", LEFT_OUT.get(section, DC)),
        )
        for section in ACTING
        for line in case.unread.get(section, ())
    ]


def _typical(unit: generators.Unit) -> Note:
    """The note on a machine of a case without DYR file."""
    common = "generator: no dynamic data: typical data of synchronous machines (Kundur, table 4.2)"
    alone = f"line {unit.row['line']}: {common}"
    return Note(alone, common, "machines", unit.name, "generator", "replaced", TYPICAL_DATA)


def _without_units(case: RawCase, grid: network.Network) -> dict[str, Any]:
    """The content of a system without generators."""
    return {
        "name": matpower_conversion.system_name(case.name),
        "description": f"{case.name}, imported from PSS/E",
        "base_power": case.base_power,
        "frequency": case.frequency,
        "line_model": "pi",
        "buses": [
            *({"name": f"B{n}", "nominal_voltage": row["BASKV"] or 1.0} for n, row in grid.buses.items()),
            *({"name": star, "nominal_voltage": 1.0} for star in grid.stars),
        ],
        "lines": grid.lines,
        "transformers": grid.transformers,
        "loads": grid.loads,
        "shunts": grid.shunts,
    }


class ImportedCase(NamedTuple):
    """A system's content, the machines with typical data, notes for the user, and what became of the records.

    `inexact`: all that is replaced or left out, with file and line.
    """

    content: dict[str, Any]
    typical: list[str]
    notes: list[str]
    records: list[report.Records]
    inexact: list[str]


def import_case(
    raw: Path, dyr: Path | None = None, load_model: LoadModel = IMPEDANCE, *, zones: bool = False
) -> ImportedCase:
    """A PSS/E case as a validated system that has a rest; `zones`: these are the areas of its machines.

    Raises `ProblemsError` with all that is wrong.
    """
    problems = Problems()
    case = read_raw(raw, problems.lines)
    for row in case.tables["bus"] if zones else ():
        row["GROUP"] = f"zone_{int(row['ZONE'])}"
    records, dyr_name = (None, "") if dyr is None else (read_dyr(dyr, problems.lines), dyr.name)
    try:
        content, dynamics, notes = convert(case, records, dyr_name, load_model=load_model, problems=problems)
    except InputError as error:
        raise ProblemsError([_with_path(text, raw, dyr) for text in problems_of(error)]) from error
    inexact = [note.alone for note in notes if isinstance(note, Note) and note.outcome in ("replaced", "left out")]
    named = [
        [text if dyr and text.startswith(f"{dyr_name}: ") else f"{raw.name}: {text}" for text in texts]
        for texts in (note_lines(notes), inexact)
    ]
    return ImportedCase(content, dynamics.typical, named[0], report.of_case(case, records, notes), named[1])


def _with_path(text: str, raw: Path, dyr: Path | None) -> str:
    """A problem with the path of its file."""
    if text.startswith((f"{raw}: ", f"{dyr}: ")):
        return text
    of_dyr = dyr is not None and text.startswith(f"{dyr.name}: ")
    return f"{dyr}: {text.partition(': ')[2]}" if of_dyr else f"{raw}: {text}"
