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
    """One comparison. `ours` and `reference` are texts, empty where the difference of whole curves is compared.

    A row without a tolerance (not a number) is open: there is nothing of ours to compare, and `cause` says why. With a
    tolerance, `cause` says why it is wider than those of other rows.
    """

    what: str
    unit: str
    ours: str
    reference: str
    difference: float
    tolerance: float
    cause: str = ""

    @property
    def open(self) -> bool:
        """Whether there is nothing to compare yet."""
        return math.isnan(self.tolerance)

    @property
    def passed(self) -> bool:
        """Whether the difference is a number within the tolerance."""
        return math.isfinite(self.difference) and self.difference <= self.tolerance

    @property
    def verdict(self) -> str:
        """In a word."""
        return "pass" if self.passed else "open" if self.open else "fail"

    def used(self) -> float:
        """The difference as a fraction of the tolerance; 0 where it is open."""
        if self.open:
            return 0.0
        return self.difference / self.tolerance if math.isfinite(self.difference) else math.inf


class ValidationTable(NamedTuple):
    """Comparisons with one source; `command` shows ours to a user."""

    title: str
    source: str
    command: str
    rows: list[Row]

    @property
    def passed(self) -> bool:
        """Whether no row fails."""
        return all(row.passed or row.open for row in self.rows)


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
        start = f"  {row.verdict.replace('fail', 'FAIL')}  {row.what:<{width}}  "
        if row.open:
            lines.append(f"{start}{row.cause}")
            continue
        pair = f"{row.ours} against {row.reference}" if row.ours else "largest difference"
        why = f" ({row.cause})" if row.cause else ""
        lines.append(f"{start}{pair} {row.unit}: {row.difference:.1e} of {row.tolerance:.1e}{why}")
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
        still = sum(row.open for row in table.rows)
        count = f"{passed}" if passed == len(table.rows) else f"{passed} of {len(table.rows)}"
        count = f"{count}, {still} open" if still else count
        count = count if table.passed else f"**{count}**"
        cells.append([table.title, table.source, count, worst.what, *figures])
    titles = ["what", "reference", "rows that pass", "worst row", "difference", "tolerance"]
    return text_tables.table(titles, cells, 2, markdown=True)


def as_csv(tables: Sequence[ValidationTable]) -> str:
    """All rows of all tables."""
    rows = [
        [
            *(table.title, table.source, table.command, *row[:4]),
            *(f"{row.difference:.1e}", f"{row.tolerance:.1e}", row.cause, row.verdict),
        ]
        for table in tables
        for row in table.rows
    ]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([["table", "source", "command", *Row._fields, "passed"], *rows])
    return text.getvalue()
