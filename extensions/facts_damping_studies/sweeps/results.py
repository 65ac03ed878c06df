"""Output files of a sweep: the table as Parquet and CSV, margins, fractions, versions; and text for a terminal."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from statistics import median
from typing import TYPE_CHECKING, Any

import pyarrow as pa
from pyarrow import csv, parquet

from facts_damping.analysis.convergence import MARK
from facts_damping.analysis.run_warnings import NOT_TUNED
from facts_damping.input_files import share_folder
from facts_damping.output.tables import table as text_table
from facts_damping.output.writing import replacing, write_whole
from facts_damping.version import versions
from facts_damping_studies.margins.margins import failed_fraction
from facts_damping_studies.sweeps.control_outcomes import missing_line, outcome_lines

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping_studies.sweeps.sweep_rows import FractionRow, MarginRow, SweepRow

    Rows = Sequence[SweepRow]
    Margins = Sequence[MarginRow]
    Cells = Mapping[str, Any]  # values of a row by column

MAX_LINES = 40  # longest table on the terminal; longer ones are only written to a file


def table(rows: Sequence[Cells]) -> pa.Table:
    """Rows as an Arrow table: columns are booleans, numbers or text; other values become text as JSON."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return pa.table({name: _column([row.get(name) for row in rows]) for name in names})


def _column(values: list[Any]) -> pa.Array:
    kinds = {type(value) for value in values if value is not None}
    if kinds == {int, float}:
        return pa.array([None if value is None else float(value) for value in values])
    if not kinds:
        return pa.array(values, pa.string())
    if len(kinds) == 1 and kinds <= {bool, int, float, str}:
        return pa.array(values)
    return pa.array([value if value is None or isinstance(value, str) else json.dumps(value) for value in values])


def _commit() -> str | None:
    git, here = shutil.which("git"), share_folder()
    if git is None or not (here / ".git").exists():
        return None
    command = [git, "-C", str(here), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stdout.strip() or None


def write(folder: Path, rows: Rows, margins: Margins, fractions: Sequence[FractionRow]) -> list[Path]:
    """Write all tables and the versions; return their paths."""
    paths = [_written(folder / "rows.parquet", [row.cells for row in rows])]
    parts: dict[str, Sequence[SweepRow | MarginRow | FractionRow]] = {
        "rows": rows, "margins": margins, "fractions": fractions,
    }  # fmt: skip
    for name, part in parts.items():
        if part:
            paths.append(_written(folder / f"{name}.csv", [row.cells for row in part]))
    about = {**versions("joblib", "pyarrow"), "git": _commit()}
    write_whole(folder / "versions.json", json.dumps(about, indent=2) + "\n")
    return [*paths, folder / "versions.json"]


def tables(folder: Path, name: str, rows: Sequence[Cells]) -> list[Path]:
    """Write rows as Parquet and CSV; return the paths."""
    return [_written(folder / f"{name}.parquet", rows), _written(folder / f"{name}.csv", rows)]


def _written(path: Path, rows: Sequence[Cells]) -> Path:
    """Write rows to a file, whole or not at all, in the format of its suffix; returns the path."""
    write_format = parquet.write_table if path.suffix == ".parquet" else csv.write_csv
    with replacing(path) as beside:
        write_format(table(rows), beside)
    return path


def sweep_tables(rows: Rows, margins: Margins, fractions: Sequence[FractionRow], across: str = "scenario") -> list[str]:
    """Lines for a terminal: counts, margins, fractions of failed runs."""
    sound = [row for row in rows if not row.error]
    lines = [f"{len(rows)} runs"]
    if sound:
        unstable = failed_fraction(sum(not row.stable for row in sound), len(sound))
        lines[0] += f", {unstable.failed} unstable ({100 * unstable.fraction:.1f} %)"
    open_ = sum(row.unsure for row in sound)
    if open_:
        lines[0] += f", {open_} not converged"
    lines += shortcomings(rows)
    if margins:
        lines += ["", *margin_table(margins, across), *legend(margins)]
    if fractions and len(fractions) <= MAX_LINES:
        lines += ["", *fraction_table(fractions)]
    return lines


def shortcomings(rows: Rows, *, hints: bool = True) -> list[str]:
    """Lines on runs that did not do what was asked: control that did not act as intended, runs that are missing."""
    missing = missing_line(rows)
    warnings = [row.figures.warnings.split("; ") for row in rows if row.figures and row.figures.warnings]
    untuned = dict.fromkeys(line for lines in warnings for line in lines if NOT_TUNED in line) if hints else {}
    return [*outcome_lines(rows, hints=hints), *untuned, *([] if missing is None else [missing])]


def legend(margins: Margins) -> list[str]:
    """What the marks in a table of margins mean, in a line; empty: there are none."""
    known = [row.over_seeds for row in margins]
    words = {
        "*": "holds again at larger values, at so many % of the coarse grid in all",
        ">": "holds at all values",
        "<": "fails at the first value",
        MARK: "otherwise with half the integration step",
        "tripped": "of the runs of its search, so many were tripped",
    }
    there = {
        "*": not all(margin.monotonic for margin in known),
        ">": any(margin.margin_s is None and margin.beyond == "high" for margin in known),
        "<": any(margin.margin_s is None and margin.beyond == "low" for margin in known),
        MARK: any(row.converged is False for row in margins),
        "tripped": any(row.tripped for row in margins),
    }
    texts = [f"`{mark}`: {text}" for mark, text in words.items() if there[mark]]
    return [f"Marks: {'; '.join(texts)}."] if texts else []


def varying(rows: Sequence[Cells], without: Sequence[str]) -> list[str]:
    """Columns that vary, without copies of an earlier one; list columns only if they group the rows in a new way."""
    name_by_values: dict[str, str] = {}
    apart: set[tuple[int, ...]] = set()
    for name in dict.fromkeys(name for row in rows for name in row if name not in without):
        values = [row.get(name) for row in rows]
        if all(value == values[0] for value in values):
            continue
        texts = list(map(json.dumps, values))
        kinds = {text: i for i, text in enumerate(dict.fromkeys(texts))}
        groups = tuple(kinds[text] for text in texts)
        if groups in apart and any(isinstance(value, list | dict) for value in values):
            continue
        apart.add(groups)
        name_by_values.setdefault(json.dumps(values), name)
    return list(name_by_values.values())


def label(row: Cells, names: Sequence[str]) -> str:
    """A label from these columns of a row; numbers with their column's name."""
    known = [(name, row[name]) for name in names if row.get(name) is not None]
    return " ".join(value if isinstance(value, str) else f"{name.split('.')[-1]}={value}" for name, value in known)


def by_scenario(rows: Rows) -> dict[str, list[SweepRow]]:
    """Rows by scenario."""
    grouped: dict[str, list[SweepRow]] = {}
    for row in rows:
        grouped.setdefault(row.columns["scenario"], []).append(row)
    return grouped


def worst(name: str) -> float:
    """What a run that loses synchronism counts as; damping ratios alone are better if they are larger."""
    return -math.inf if "damping_ratio" in name else math.inf


def counted(row: SweepRow, name: str) -> float:
    """A figure of a run as medians count it: not a number if unknown, infinitely bad if synchronism is lost."""
    if row.unsure:
        return math.nan
    if not row.stable:
        return worst(name)
    value = row.cells.get(name)
    return math.nan if value is None else float(value)


def margin_names(margins: Margins, across: str) -> list[str]:
    """Columns that identify a margin, except scenario, horizon and the column shown side by side."""
    return varying([row.place for row in margins], ("horizon_s", "scenario", across))


def ranked(margins: Margins, names: Sequence[str]) -> list[tuple[Any, ...]]:
    """Values of these columns, ranked by the median margin of the first criterion, the largest first.

    Entries with a margin that is not converged come last, without a rank.
    """
    reached: dict[tuple[Any, ...], list[float]] = {}
    unsure: set[tuple[Any, ...]] = set()
    for row in margins:
        if row.criterion == margins[0].criterion:
            who = tuple(row.place.get(name) for name in names)
            reached.setdefault(who, []).append(reach(row))
            if row.converged is False:
                unsure.add(who)
    return sorted(reached, key=lambda entry: (entry in unsure, -median(reached[entry])))


def reach(row: MarginRow) -> float:
    """A margin for sorting and drawing; beyond the range, the end of the range."""
    known = row.over_seeds.margin_s if row.over_seeds.beyond is None else row.over_seeds.low_s
    return float(known or 0.0)


def margin_table(margins: Margins, across: str) -> list[str]:
    """Margins in Markdown with the values of `across` side by side: a table per criterion, and per scenario if needed.

    A star and the holding fraction of the coarse grid mark margins that hold again at larger values.
    """
    names, columns = margin_names(margins, across), list(dict.fromkeys(row.place[across] for row in margins))
    lines: list[str] = []
    for criterion in dict.fromkeys(row.criterion for row in margins):
        for scenario, scenario_rows in beneath([row for row in margins if row.criterion == criterion], across).items():
            place = {(row.place[across], *(row.place.get(name) for name in names)): row for row in scenario_rows}
            horizons = "/".join(
                f"{h:g}" for h in dict.fromkeys(row.place["horizon_s"] for row in scenario_rows) if h is not None
            )
            head = ", ".join(part for part in (criterion, scenario, scenario_rows[0].over_seeds.field) if part)
            who = ranked(scenario_rows, names)
            cells = [
                [*map(cell, entry), *(margin_text(place.get((column, *entry))) for column in columns)] for entry in who
            ]
            titles = [*names, *(f"{cell(c)} [low, high]" for c in columns)]
            table_lines = text_table(titles, cells, len(names), markdown=True)
            lines += [f"{head}, horizon {horizons} s:", "", *table_lines, ""]
    return lines


def beneath(margins: Margins, across: str) -> dict[str, list[MarginRow]]:
    """Groups of margins shown below each other: by scenario, or all if scenarios are side by side."""
    grouped: dict[str, list[MarginRow]] = {}
    for row in margins:
        grouped.setdefault("" if across == "scenario" else row.place["scenario"], []).append(row)
    return grouped


def margin_text(row: MarginRow | None) -> str:
    """A margin with its bracket or interval."""
    if row is None:
        return ""
    margin, star = row.over_seeds, ""
    if not margin.monotonic:
        star = f" * {100 * (row.holds or 0.0):.0f} %"
        if len(row.holds_s) > 1:
            star += f", also {', '.join(f'{low:.3f} to {high:.3f}' for low, high in row.holds_s[1:])}"
    if row.converged is False:
        star += " " + MARK
    if row.tripped:
        star += f" ({row.tripped} tripped)"
    if margin.margin_s is None:
        return {"high": f"> {cell(margin.low_s)}", "low": f"< {cell(margin.high_s)}", None: "-"}[margin.beyond] + star
    return f"{margin.margin_s:.3f} [{cell(margin.low_s)}, {cell(margin.high_s)}]{star}"


def spans(values: Sequence[float]) -> str:
    """Values as a range from the least to the largest."""
    if not values:
        return ""
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"


def fraction_table(fractions: Sequence[FractionRow]) -> list[str]:
    """Fractions of failed runs in Markdown."""
    columns = varying([{**row.place, "criterion": row.criterion} for row in fractions], ())
    checked, trips = any(row.not_converged is not None for row in fractions), any(row.tripped for row in fractions)
    cells = []
    for row in fractions:
        runs, _, fraction, low, high = row.fraction
        counted = [str(runs), f"{100 * fraction:.1f}", f"{100 * low:.1f} to {100 * high:.1f}"]
        counted += ([cell(row.not_converged)] if checked else []) + ([str(row.tripped)] if trips else [])
        cells.append([*(cell(row.cells.get(name)) for name in columns), *counted])
    titles = [*columns, "runs", "failed, %", "95 % interval", *(["not converged"] if checked else [])]
    titles += ["tripped"] if trips else []
    return text_table(titles, cells, len(columns), markdown=True)


def cell(value: Any) -> str:
    """A value formatted for a table."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
