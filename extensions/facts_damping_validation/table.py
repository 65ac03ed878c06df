"""Tables of comparisons: ours, the reference, the difference, the tolerance, pass or fail."""

from __future__ import annotations

import csv
import io
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.input_files import share_folder
from facts_damping.output import tables as text_tables

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


class Row(NamedTuple):
    """One comparison. `ours` and `reference` are texts, empty where the difference of whole curves is compared."""

    what: str
    unit: str
    ours: str
    reference: str
    difference: float
    tolerance: float

    @property
    def passed(self) -> bool:
        """Whether the difference is a number within the tolerance."""
        return math.isfinite(self.difference) and self.difference <= self.tolerance

    def used(self) -> float:
        """The difference as a fraction of the tolerance."""
        return self.difference / self.tolerance if math.isfinite(self.difference) else math.inf


class ValidationTable(NamedTuple):
    """Comparisons with one source; `command` shows ours to a user."""

    title: str
    source: str
    command: str
    rows: list[Row]

    @property
    def passed(self) -> bool:
        """Whether all rows pass."""
        return all(row.passed for row in self.rows)


def compare(what: str, unit: str, ours: complex, reference: complex, tolerance: float, form: str = ".4f") -> Row:
    """Two numbers; the difference of complex ones is its absolute value."""
    return Row(what, unit, _number(ours, form), _number(reference, form), float(abs(ours - reference)), tolerance)


def within(what: str, unit: str, differences: Any, tolerance: float) -> Row:
    """Whole curves or lists: the largest absolute difference."""
    return Row(what, unit, "", "", float(np.max(np.abs(differences))), tolerance)


def _number(value: complex, form: str) -> str:
    """A number as text; mypy takes a float for a complex."""
    z = complex(value)
    return f"{z.real:{form}}" + ("" if np.isrealobj(value) else f" {'-' if z.imag < 0 else '+'} j{abs(z.imag):{form}}")


def figures(name: str) -> NDArray[np.void]:
    """A shipped file of reference figures, by its columns' names."""
    path = share_folder() / "config" / "references" / f"{name}.csv"
    return np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")


def furthest(ours: NDArray[np.complex128], theirs: NDArray[np.complex128]) -> float:
    """Largest distance of one of `theirs` from the nearest of `ours`; not a number where their counts differ."""
    if len(ours) != len(theirs):
        return math.nan
    return float(np.abs(np.asarray(ours)[:, None] - np.asarray(theirs)[None]).min(axis=0).max())


def table_text(table: ValidationTable) -> list[str]:
    """Lines of a table for the terminal."""
    width = max(len(row.what) for row in table.rows)
    lines = [f"{table.title} ({table.source})"]
    for row in table.rows:
        pair = f"{row.ours} against {row.reference}" if row.ours else "largest difference"
        start = f"  {'pass' if row.passed else 'FAIL'}  {row.what:<{width}}  {pair} {row.unit}"
        lines.append(f"{start}: {row.difference:.1e} of {row.tolerance:.1e}")
    return lines


def document(tables: Sequence[ValidationTable]) -> list[dict[str, Any]]:
    """The tables as JSON."""
    return [
        {**t._asdict(), "passed": t.passed, "rows": [{**r._asdict(), "passed": r.passed} for r in t.rows]}
        for t in tables
    ]


def summary(tables: Sequence[ValidationTable]) -> list[str]:
    """Markdown with a row per table: of its rows the one that uses most of its tolerance."""
    cells = []
    for table in tables:
        worst = max(table.rows, key=Row.used)
        unit = "" if worst.unit == "-" else f" {worst.unit}"
        figures = [f"{worst.difference:.1e}{unit}", f"{worst.tolerance:.1e}"]
        passed = sum(row.passed for row in table.rows)
        count = f"{passed}" if table.passed else f"**{passed} of {len(table.rows)}**"
        cells.append([table.title, table.source, count, worst.what, *figures])
    titles = ["what", "reference", "rows that pass", "worst row", "difference", "tolerance"]
    return text_tables.table(titles, cells, 2, markdown=True)


def as_csv(tables: Sequence[ValidationTable]) -> str:
    """All rows of all tables."""
    rows = [
        [table.title, table.source, table.command, *row[:4], f"{row.difference:.1e}", f"{row.tolerance:.1e}", passed]
        for table in tables
        for row, passed in ((row, "pass" if row.passed else "fail") for row in table.rows)
    ]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([["table", "source", "command", *Row._fields, "passed"], *rows])
    return text.getvalue()
