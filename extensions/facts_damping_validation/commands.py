"""The command `validate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from facts_damping.cli.reporting import say
from facts_damping.errors import RunError, check_known
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_json, write_whole
from facts_damping.parameters import files

if TYPE_CHECKING:
    import argparse


def validate(arguments: argparse.Namespace) -> None:
    """Check the plant against published figures, other programs, analytic solutions and finer steps."""
    from facts_damping_validation import report, table

    files.check_writable(arguments.out, "--out")
    for name in arguments.tables:
        check_known("TABLE", name, report.TABLES)
    names, tables = arguments.tables or list(report.TABLES), []
    with Progress("validate", "tables") as progress:
        for i, name in enumerate(names):
            progress(i, len(names))
            tables.append(report.TABLES[name]())
    write_json(arguments.json, table.document(tables))
    if arguments.out is not None:
        path = Path(arguments.out)
        write_whole(path, report.page(tables))
        if path.is_file() and path.suffix != ".csv":
            write_whole(path.with_suffix(".csv"), table.as_csv(tables))
    say(arguments, *(line for validated in tables for line in [*table.table_text(validated), ""]))
    rows = [row for validated in tables for row in validated.rows]
    failed = [row.what for row in rows if not (row.passed or row.open)]
    if failed:
        raise RunError(f"validate: {len(failed)} rows fail: {'; '.join(failed)}")
    still = sum(row.open for row in rows)
    say(arguments, f"{len(rows) - still} rows pass" + (f", {still} are open" if still else ""))
