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
from facts_damping.analysis.run_warnings import NEVER_ARMED
from facts_damping.input_files import share_folder
from facts_damping.output.tables import table as text_table
from facts_damping.output.writing import replacing, write_whole
from facts_damping.version import versions
from facts_damping_studies.margins.margins import failed_fraction

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    Rows = Sequence[dict[str, Any]]

MAX_LINES = 40  # longest table on the terminal; longer ones are only written to a file


def table(rows: Rows) -> pa.Table:
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


def write(folder: Path, rows: Rows, margins: Rows, fractions: Rows) -> list[Path]:
    """Write all tables and the versions; return their paths."""
    made = [_written(folder / "rows.parquet", rows)]
    for name, some in (("rows", rows), ("margins", margins), ("fractions", fractions)):
        if some:
            made.append(_written(folder / f"{name}.csv", some))
    about = {**versions("joblib", "pyarrow"), "git": _commit()}
    write_whole(folder / "versions.json", json.dumps(about, indent=2) + "\n")
    return [*made, folder / "versions.json"]


def tables(folder: Path, name: str, rows: Rows) -> list[Path]:
    """Write rows as Parquet and CSV; return the paths."""
    return [_written(folder / f"{name}.parquet", rows), _written(folder / f"{name}.csv", rows)]


def _written(path: Path, rows: Rows) -> Path:
    """Write rows to a file, whole or not at all, in the format of its suffix; returns the path."""
    write_format = parquet.write_table if path.suffix == ".parquet" else csv.write_csv
    with replacing(path) as beside:
        write_format(table(rows), beside)
    return path


def sweep_tables(rows: Rows, margins: Rows, fractions: Rows, across: str = "scenario") -> list[str]:
    """Lines for a terminal: counts, margins, fractions of failed runs."""
    failed = [row["error"] for row in rows if row["error"]]
    sound = [row for row in rows if not row["error"]]
    lines = [f"{len(rows)} runs"]
    if sound:
        unstable = failed_fraction(sum(not row["stable"] for row in sound), len(sound))
        lines[0] += f", {unstable['failed']} unstable ({100 * unstable['fraction']:.1f} %)"
    open_ = sum(row.get("converged") is False for row in sound)
    if open_:
        lines[0] += f", {open_} not converged"
    never = sum(NEVER_ARMED in (row.get("warnings") or "") for row in sound)
    if never:
        lines[0] += f", {never} with a controller that was {NEVER_ARMED}"
    if failed:
        lines.append(f"{len(failed)} could not be made, the first: {failed[0]}")
    if margins:
        lines += ["", *margin_table(margins, across)]
    if fractions and len(fractions) <= MAX_LINES:
        lines += ["", *fraction_table(fractions)]
    return lines


def varying(rows: Rows, without: Sequence[str]) -> list[str]:
    """Columns that vary, without copies of an earlier one; list columns only if they group the rows in a new way."""
    found: dict[str, str] = {}
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
        found.setdefault(json.dumps(values), name)
    return list(found.values())


FOUND = (
    *("converged", "margin_s", "low_s", "high_s", "seeds", "monotonic", "holds_again", "holds", "holds_s", "beyond"),
    *("per_seed", "field"),
)
COUNTED = ("runs", "failed", "fraction", "low", "high", "not_converged")


def label(row: dict[str, Any], names: Sequence[str]) -> str:
    """A label from these columns of a row; numbers with their column's name."""
    known = [(name, row[name]) for name in names if row.get(name) is not None]
    return " ".join(value if isinstance(value, str) else f"{name.split('.')[-1]}={value}" for name, value in known)


def by_scenario(rows: Rows) -> dict[str, list[dict[str, Any]]]:
    """Rows by scenario."""
    return {name: [r for r in rows if r["scenario"] == name] for name in dict.fromkeys(r["scenario"] for r in rows)}


def worst(name: str) -> float:
    """What a run that loses synchronism counts as; damping ratios alone are better if they are larger."""
    return -math.inf if "damping_ratio" in name else math.inf


def counted(row: Mapping[str, Any], name: str) -> float:
    """A figure of a run as medians count it: not a number if unknown, infinitely bad if synchronism is lost."""
    if row.get("converged") is False:
        return math.nan
    if not row.get("stable"):
        return worst(name)
    value = row.get(name)
    return math.nan if value is None else float(value)


def margin_names(margins: Rows, across: str) -> list[str]:
    """Columns that identify a margin, except criterion, scenario and the column shown side by side."""
    return varying(margins, (*FOUND, "horizon_s", "criterion", "scenario", across))


def ranked(margins: Rows, names: Sequence[str]) -> list[tuple[Any, ...]]:
    """Values of these columns, ranked by the median margin of the first criterion, the largest first.

    Entries with a margin that is not converged come last, without a rank.
    """
    reached: dict[tuple[Any, ...], list[float]] = {}
    unsure: set[tuple[Any, ...]] = set()
    for row in margins:
        if row["criterion"] == margins[0]["criterion"]:
            who = tuple(row.get(name) for name in names)
            reached.setdefault(who, []).append(reach(row))
            if row.get("converged") is False:
                unsure.add(who)
    return sorted(reached, key=lambda one: (one in unsure, -median(reached[one])))


def reach(row: dict[str, Any]) -> float:
    """A margin for sorting and drawing; beyond the range, the end of the range."""
    known = row["margin_s"] if row["beyond"] is None else row["low_s"]
    return float(known or 0.0)


def margin_table(margins: Rows, across: str) -> list[str]:
    """Margins in Markdown with the values of `across` side by side: a table per criterion, and per scenario if needed.

    A star and the holding fraction of the coarse grid mark margins that hold again at larger values.
    """
    names, columns = margin_names(margins, across), list(dict.fromkeys(row[across] for row in margins))
    lines: list[str] = []
    for criterion in dict.fromkeys(row["criterion"] for row in margins):
        for scenario, own in beneath([row for row in margins if row["criterion"] == criterion], across).items():
            place = {(row[across], *(row.get(name) for name in names)): row for row in own}
            horizons = "/".join(f"{h:g}" for h in dict.fromkeys(row["horizon_s"] for row in own) if h is not None)
            head = ", ".join(part for part in (criterion, scenario, own[0]["field"]) if part)
            who = ranked(own, names)
            cells = [[*map(cell, one), *(margin_text(place.get((column, *one))) for column in columns)] for one in who]
            titles = [*names, *(f"{cell(c)} [low, high]" for c in columns)]
            table_lines = text_table(titles, cells, len(names), markdown=True)
            lines += [f"{head}, horizon {horizons} s:", "", *table_lines, ""]
    return lines


def beneath(margins: Rows, across: str) -> dict[str, list[dict[str, Any]]]:
    """Groups of margins shown below each other: by scenario, or all if scenarios are side by side."""
    return {"": list(margins)} if across == "scenario" else by_scenario(margins)


def margin_text(row: dict[str, Any] | None) -> str:
    """A margin with its bracket or interval."""
    if row is None:
        return ""
    star = "" if row["monotonic"] else f" * {100 * row['holds']:.0f} %"
    if not row["monotonic"] and len(row.get("holds_s") or ()) > 1:
        star += f", also {', '.join(f'{low:.3f} to {high:.3f}' for low, high in row['holds_s'][1:])}"
    if row.get("converged") is False:
        star += " " + MARK
    if row["margin_s"] is None:
        return {"high": f"> {cell(row['low_s'])}", "low": f"< {cell(row['high_s'])}", None: "-"}[row["beyond"]] + star
    return f"{row['margin_s']:.3f} [{cell(row['low_s'])}, {cell(row['high_s'])}]{star}"


def spans(values: Sequence[float]) -> str:
    """Values as a range from the least to the largest."""
    if not values:
        return ""
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"


def fraction_table(fractions: Rows) -> list[str]:
    """Fractions of failed runs in Markdown."""
    columns = varying(fractions, COUNTED)
    checked = any("not_converged" in row for row in fractions)
    cells = []
    for row in fractions:
        interval = f"{100 * row['low']:.1f} to {100 * row['high']:.1f}"
        counted = [str(row["runs"]), f"{100 * row['fraction']:.1f}", interval]
        counted += [cell(row.get("not_converged"))] if checked else []
        cells.append([*(cell(row.get(name)) for name in columns), *counted])
    titles = [*columns, "runs", "failed, %", "95 % interval", *(["not converged"] if checked else [])]
    return text_table(titles, cells, len(columns), markdown=True)


def cell(value: Any) -> str:
    """A value formatted for a table."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
