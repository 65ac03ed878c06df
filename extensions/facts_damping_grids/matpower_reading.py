"""MATPOWER files: reading a case and converting it to a system."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError
from facts_damping.extras import library
from facts_damping.input_files import GRID, is_file, read_text
from facts_damping.parameters.field_errors import check, short
from facts_damping.parameters.files import read_table
from facts_damping.parameters.plant.system import System
from facts_damping_grids.matpower_conversion import Imported, MatpowerCase, convert

if TYPE_CHECKING:
    from pathlib import Path

NEEDED = {
    "bus": ("BUS_I", "BUS_TYPE", "PD", "QD", "GS", "BS", "VM", "VA", "BASE_KV"),
    "gen": ("GEN_BUS", "PG", "QG", "VG", "MBASE", "GEN_STATUS", "PMAX", "PMIN"),
    "branch": ("F_BUS", "T_BUS", "BR_R", "BR_X", "BR_B", "TAP", "SHIFT", "BR_STATUS"),
}


def read_case(path: Path) -> MatpowerCase:
    """Tables of a MATPOWER case, format version 2."""
    allowed = "allowed: a MATPOWER case of version 2, with tables of plain numbers (savecase writes such)"
    if path.suffix != ".m" or not is_file(path):
        raise InputError(f"{path}: no such case; allowed: an existing MATPOWER file (.m)")
    frames_of = library("matpowercaseframes", "matpower", where="import").CaseFrames
    text = read_text(path, GRID, "replace")
    try:
        for number, line in enumerate(text.splitlines(), 1):
            if re.match(r"\s*mpc\.(bus|gen|branch)\s*\(", line):
                raise InputError(f"{path}: line {number}: computes in a table: {short(line.strip())}; {allowed}")
        frames = frames_of(str(path), update_index=False)
        tables = {table: getattr(frames, table).to_dict("records") for table in NEEDED}
        base = float(frames.baseMVA)
        dc = [row for row in frames.dcline.to_dict("records") if row["BR_STATUS"]] if hasattr(frames, "dcline") else []
    except (AttributeError, IndexError, KeyError, TypeError, ValueError, OSError) as error:
        raise InputError(f"{path}: not a MATPOWER case; {allowed}") from error
    for table, columns in NEEDED.items():
        for number, row in enumerate(tables[table], 1):
            for column in columns:
                row[column] = _finite(row.get(column), f"{path}: mpc.{table}, row {number}: {column}")
    return MatpowerCase(path.stem, base, tables["bus"], tables["gen"], tables["branch"], len(dc))


def _finite(value: Any, where: str) -> float:
    """A cell as a number: if one cell of a table is text, the library returns all of them as text."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        raise InputError(f"{where}: {short(value)} given; allowed: a finite number")
    return number


def import_case(path: Path, dynamics: Path | None = None) -> Imported:
    """A MATPOWER case as a validated system, with notes for the user."""
    case = read_case(path)
    if dynamics is not None and not is_file(dynamics):
        raise InputError(f"--dynamics {dynamics}: no such file; allowed: an existing YAML file")
    dynamic_rows = None if dynamics is None else read_table(dynamics)
    try:
        imported = convert(case, dynamic_rows)
    except InputError as error:
        text = str(error)
        source = dynamics if text.startswith("--dynamics") else path
        raise InputError(f"{source}: {text.removeprefix('--dynamics: ')}") from error
    check(System, imported.content, str(path) if dynamics is None else f"{path} with {dynamics}")
    return imported._replace(notes=[f"{path.name}: {note}" for note in imported.notes])
