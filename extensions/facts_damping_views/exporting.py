"""The command `export`: a recording as a table, one row per tick, one column per quantity; a system for others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from facts_damping.case import loading
from facts_damping.cli.reporting import say
from facts_damping.errors import InputError
from facts_damping.extensions import given
from facts_damping.output.terminal import note
from facts_damping.output.writing import replacing, write_whole
from facts_damping.parameters import files
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.reader import load
from facts_damping.recording.writer import writing

if TYPE_CHECKING:
    import argparse

    from facts_damping.record import Record

ANDES = ".lst"
KINDS = (".parquet", ".csv", ANDES)


def export(arguments: argparse.Namespace) -> None:
    """Write all signals of a recording, one row per tick; or a system for other programs."""
    path, of_system = Path(arguments.out), {f".{name}": row for name, row in given("exports").items()}
    if path.suffix not in (*KINDS, *of_system):
        *others, last = [*KINDS, *of_system]
        raise InputError(f"--out {path}: given; allowed: a file that ends with {', '.join(others)} or {last}")
    files.check_writable(str(path), "--out")
    if path.suffix in of_system:
        system = loading.load_system(arguments.what)
        write_whole(path, of_system[path.suffix].load()(system, path))
        inverters = f", {len(system.inverters)} inverters" if system.inverters else ""
        say(arguments, f"{len(system.buses)} buses, {len(system.machines)} machines{inverters}: {path}")
        return
    record = load(arguments.what)
    write(record, path)
    for line in record.notes:
        note(f"{arguments.what}: {line}")
    say(arguments, f"{len(record.time_ns)} ticks, {len(record.arrays)} columns: {path}")


def write(record: Record, path: Path) -> None:
    """Write `record.arrays` to a `.parquet`, `.csv` or `.lst` file, whole or not at all.

    Parquet: the metadata of each field hold its unit, those of the file the run (YAML). CSV: column names end with the
    unit. NaN is NaN in Parquet and the text `nan` in CSV. A `.lst` is the format of ANDES's plots: names of the
    columns, time first; their values are in an `.npz` beside it. Raises RecordingError.
    """
    if path.suffix == ANDES:
        _write_andes(record, path)
        return
    fields = [
        pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"unit": record.units[name]})
        for name, values in record.arrays.items()
    ]
    schema = pa.schema(fields, metadata={"run.yaml": dump(record.configuration)})
    table = pa.table([pa.array(values) for values in record.arrays.values()], schema=schema)
    with writing(path), replacing(path) as beside:
        if path.suffix == ".csv":
            csv.write_csv(table, beside)
        else:
            parquet.write_table(table, beside)


def _write_andes(record: Record, path: Path) -> None:
    """Write rows `number, name, name in TeX` and the array `data` (ticks, columns), as `andes plot` reads them."""
    columns = {name: values for name, values in record.arrays.items() if name != "time_s"}
    data = np.column_stack([record.time_s, *(values.astype(float) for values in columns.values())])
    rows = [f"{i:>6}, {name}, {name}" for i, name in enumerate(["Time [s]", *columns])]
    with writing(path):
        with replacing(path.with_suffix(".npz")) as beside, beside.open("wb") as file:
            np.savez_compressed(file, data=data)
        with replacing(path) as beside:
            beside.write_text("\n".join(rows) + "\n", encoding="utf-8")
