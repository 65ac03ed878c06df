"""Writes a record as a table for other programs: one row per tick, one column per quantity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa
from pyarrow import csv, parquet

from facts_damping.output.writing import replacing
from facts_damping.parameters.yaml_text import dump
from facts_damping.recording.writer import writing

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.record import Record

ANDES = ".lst"
KINDS = (".parquet", ".csv", ANDES)


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
