"""The figures that the thesis prints in its tables of results, as data, with the slips that they give away themselves.

Files and their origin: `config/references/thesis`.
"""

from __future__ import annotations

import csv
import math
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.analysis.indices import THESIS_INDICES
from facts_damping.errors import InputError, check_known
from facts_damping.input_files import share_folder
from facts_damping.neurofuzzy.table import VARIANTS

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from facts_damping_studies.sweeps.enumerated_axes import Scheme

ROUGHNESS = "roughness"
SCENARIOS = {  # as the thesis numbers them, and their names here
    "smib": {"I": "nominal", "II": "light", "III": "heavy", "IV": "multiple"},
    "two_area": {"I": "small", "II": "large", "III": "multiple"},
}


class ControllerId(NamedTuple):
    """A controller with its architecture, "MISO" or "MIMO", and its scheme (of LLC none)."""

    architecture: str
    controller: str
    scheme: Scheme


LLC = ControllerId("MISO", "LLC", None)
DIRECT = ControllerId("MISO", "ANFTSC", "direct")
REFERENCES = {"ANFTSC": DIRECT, "LLC": LLC}  # of improvements, in all tables


class PrintedTable(NamedTuple):
    """What a table shows; `who` is the architecture and scheme of its rows, in tables of roughness its columns'."""

    title: str
    system: str
    figures: int  # printed in it
    who: tuple[str, Scheme] | None = None


TABLES = {
    "4.1": PrintedTable("SMIB, direct: improvement", "smib", 336, ("MISO", "direct")),
    "4.2": PrintedTable("Two areas, direct: improvement", "two_area", 252, ("MISO", "direct")),
    "5.1": PrintedTable("SMIB, indirect: improvement", "smib", 352, ("MISO", "indirect")),
    "5.2": PrintedTable("SMIB: roughness of the control effort", "smib", 92),
    "5.3": PrintedTable("Two areas, indirect: improvement", "two_area", 264, ("MISO", "indirect")),
    "5.4": PrintedTable("Two areas: roughness of the control effort", "two_area", 69),
    "6.1": PrintedTable("Two areas, SSSC and STATCOM: roughness of the control effort", "two_area", 33),
    "6.2": PrintedTable("Two areas, SSSC and STATCOM: improvement", "two_area", 84, ("MIMO", "indirect")),
}
COMPLEXITY = "Parameters updated and operations of a forward pass, two inputs and two rules"  # table 3.1


class Cell(NamedTuple):
    """A printed figure: an improvement (4.109), %, or a roughness (5.34)."""

    table: str  # "4.1"
    system: str
    scenario: str  # as in config/scenarios
    architecture: str
    controller: str
    scheme: Scheme
    quantity: str  # ITAE, IAE, ITSE, ISE or roughness
    against: ControllerId | None  # the controller that it is an improvement over; none: a roughness
    printed: float
    corrected: float  # the same where it is no slip
    reason: str  # of a slip, else empty
    decimals: int  # printed

    @property
    def who(self) -> ControllerId:
        """The controller that the figure belongs to."""
        return ControllerId(self.architecture, self.controller, self.scheme)


class Operations(NamedTuple):
    """A row of table 3.1; an empty field counts as 0."""

    controller: str
    parameters: int  # updated
    additions: int  # and subtractions
    multiplications: int
    divisions: int
    exponentials: int
    trigonometric: int


class Break(NamedTuple):
    """Two cells that contradict each other: improvements over direct ANFTSC and over LLC."""

    over_anftsc: Cell
    over_llc: Cell
    expected: float  # %, over LLC by the other one
    bound: float  # %, what rounding can make of the difference


def folder() -> Path:
    """Where the figures lie."""
    return share_folder() / "config" / "references" / "thesis"


def cells(tables: Iterable[str] = TABLES) -> list[Cell]:
    """The figures of tables, in their order. Raises `InputError` for an unknown table or a damaged file."""
    by_place: dict[tuple[str, str, str, str], Cell] = {}
    for number in tables:
        check_known("table", number, TABLES)
        by_place |= _cells(number)
    return list(_corrected(by_place).values())


def operations() -> list[Operations]:
    """The rows of table 3.1. Raises `InputError` for a damaged file."""
    path = _file("3.1")
    rows = _rows(path, Operations._fields)
    names = [row["controller"] for row in rows]
    if names != list(VARIANTS):
        raise InputError(f"{path}: rows of {', '.join(names)} given; allowed: {', '.join(VARIANTS)}")
    counts = Operations._fields[1:]
    return [Operations(r["controller"], *(int(_number(r[c] or "0", path, c)) for c in counts)) for r in rows]


def inconsistent(read_cells: Sequence[Cell], *, corrected: bool = False) -> list[Break]:
    """Pairs of improvements of a table that contradict each other by more than rounding, as printed or as corrected.

    With a the improvement over direct ANFTSC, b that of direct ANFTSC over LLC (tables 4.1, 4.2), that over LLC is
    c = 1 - (1 - a)(1 - b). Rounding by at most h each moves c by up to (1 - b) h_a + (1 - a) h_b + h_a h_b + h_c.
    """
    at = {_place(c): c for c in [*cells(("4.1", "4.2")), *read_cells]}
    breaks = []
    for cell in read_cells:
        if cell.against != DIRECT:
            continue
        partner = at[_place(cell._replace(against=LLC))]
        base = at[_place(partner._replace(architecture="MISO", controller="ANFTSC", scheme="direct"))]
        a, b, c = ((x.corrected if corrected else x.printed) / 100 for x in (cell, base, partner))
        h_a, h_b, h_c = (0.5 * 10.0**-x.decimals / 100 for x in (cell, base, partner))
        expected = 1 - (1 - a) * (1 - b)
        bound = (1 - b) * h_a + (1 - a) * h_b + h_a * h_b + h_c
        if abs(expected - c) > bound + 1e-12:
            breaks.append(Break(cell, partner, 100 * expected, 100 * bound))
    return breaks


def _place(cell: Cell) -> tuple[str, str, str, ControllerId, ControllerId | None]:
    """What a figure is of, whatever table it stands in."""
    return cell.system, cell.scenario, cell.quantity, cell.who, cell.against


def _cells(number: str) -> dict[tuple[str, str, str, str], Cell]:
    """The cells of a table by number, scenario as printed, controller and column."""
    path, table = _file(number), TABLES[number]
    names = SCENARIOS[table.system]
    columns, by_place = _columns(number), {}
    for row in _rows(path, [*(["scenario"] if table.who else []), "controller", *columns]):
        controller = row["controller"]
        check_known(f"{path}: controller", controller, ["LLC", *VARIANTS])
        for column in columns:
            if not row[column]:
                continue
            scenario, who, quantity, against = _meaning(table, row, column)
            check_known(f"{path}: scenario", scenario, names)
            value, text = _number(row[column], path, column), row[column]
            decimals = len(text.partition(".")[2])
            by_place[number, scenario, controller, column] = Cell(
                number, table.system, names[scenario], *who, quantity, against, value, value, "", decimals
            )
    if len(by_place) != table.figures:
        raise InputError(f"{path}: {len(by_place)} figures given; allowed: the {table.figures} of the table")
    return by_place


def _columns(number: str) -> list[str]:
    """Columns of figures of a table."""
    if TABLES[number].who:
        return [f"{index}_vs_{reference}" for reference in REFERENCES for index in THESIS_INDICES]
    kinds = ["MISO_direct", "MISO_indirect", *(["MIMO_indirect"] if number == "6.1" else [])]
    return [f"{scenario}_{kind}" for scenario in SCENARIOS[TABLES[number].system] for kind in kinds]


def _meaning(
    table: PrintedTable, row: dict[str, str], column: str
) -> tuple[str, ControllerId, str, ControllerId | None]:
    """Scenario, controller, quantity and reference of a cell."""
    first, *rest = column.split("_")
    scheme: Any
    if table.who is None:
        architecture, scheme = rest
        quantity, scenario, against = ROUGHNESS, first, None
    else:
        architecture, scheme = table.who
        quantity, scenario, against = first, row["scenario"], REFERENCES[rest[-1]]
    return (
        scenario,
        ControllerId(architecture, row["controller"], None if row["controller"] == "LLC" else scheme),
        quantity,
        against,
    )


def _corrected(by_place: dict[tuple[str, str, str, str], Cell]) -> dict[tuple[str, str, str, str], Cell]:
    """The cells with the slips of `corrections.csv` in them."""
    path, numbers = folder() / "corrections.csv", {key[0] for key in by_place}
    for row in _rows(path, ("table", "scenario", "controller", "column", "printed", "corrected", "reason")):
        key = (row["table"], row["scenario"], row["controller"], row["column"])
        check_known(f"{path}: table", row["table"], TABLES)
        if row["table"] not in numbers:
            continue
        cell, printed = by_place.get(key), _number(row["printed"], path, "printed")
        if cell is None or cell.printed != printed or not row["reason"]:
            printed_before = cell and cell.printed
            raise InputError(
                f"{path}: {' '.join(key)}: {printed} given; allowed: the printed figure ({printed_before}), a reason"
            )
        by_place[key] = cell._replace(corrected=_number(row["corrected"], path, "corrected"), reason=row["reason"])
    return by_place


def _file(number: str) -> Path:
    return folder() / f"table_{number.replace('.', '_')}.csv"


def _rows(path: Path, columns: Sequence[str]) -> list[dict[str, str]]:
    """The rows of a file with the columns given. Raises `InputError`."""
    try:
        header, *lines = csv.reader(path.read_text(encoding="utf-8").splitlines(), strict=True)
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}; allowed: a CSV file with a header, UTF-8") from error
    if header != list(columns):
        raise InputError(f"{path}: header {','.join(header)} given; allowed: {','.join(columns)}")
    for number, line in enumerate(lines, start=2):
        if len(line) != len(header):
            raise InputError(f"{path}: line {number}: {len(line)} fields given; allowed: {len(header)}")
    return [dict(zip(header, line, strict=True)) for line in lines]


def _number(text: str, path: Path, column: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}: {column}: '{text}' given; allowed: a number")
    return value
