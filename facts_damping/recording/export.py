"""A record as a table for other programs: a row a tick, a column a quantity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pyarrow as pa
from pyarrow import csv, parquet

from facts_damping.errors import RecordingError
from facts_damping.parameters.yaml_text import dump
from facts_damping.terminal import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from facts_damping.signals import Record

KINDS = (".parquet", ".csv")


def write(record: Record, path: Path) -> None:
    """Write `record.arrays` to a `.parquet` or `.csv` file, whole or not at all.

    Parquet holds the unit of each column in its field's metadata, and the run (YAML) in that of the file; of CSV a
    column's name ends with its unit. NaN is NaN in Parquet, in CSV the text `nan`. Raises RecordingError.
    """
    fields = [
        pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"unit": record.units[name]})
        for name, values in record.arrays.items()
    ]
    schema = pa.schema(fields, metadata={"run.yaml": dump(record.configuration)})
    table = pa.table([pa.array(values) for values in record.arrays.values()], schema=schema)
    try:
        with replacing(path) as beside:
            if path.suffix == ".csv":
                csv.write_csv(table, beside)
            else:
                parquet.write_table(table, beside)
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}") from error
