"""The digest of a run: the same for runs whose signals are all identical bit for bit."""

from __future__ import annotations

from dataclasses import fields
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.recfunctions import drop_fields

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.record import Record

LENGTH = 16  # hexadecimal digits shown and stored
YOUNGER = {"devices": ["state"]}  # fields that came after the first digests: they count where a value is known
OLDER = {"supervision": ("values", 23)}  # likewise columns of a field: those after the first 23
NAMES = ("pmus", "machine_names", "device_names", "controller_names")  # names of the signals' columns


def digest(record: Record) -> str:
    """First hexadecimal digits of the SHA-256 of a record's arrays (with names, fields and shapes) and of `NAMES`.

    Left out is what the run does not determine: the configuration's text, refused messages, publishers.
    """
    hashed = sha256(repr([list(getattr(record, name)) for name in NAMES]).encode())
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, np.ndarray):
            left_out = [name for name in YOUNGER.get(field.name, []) if np.isnan(value[name]).all()]
            table = canonical(drop_fields(value, left_out, usemask=False) if left_out else value)
            if field.name in OLDER:
                table = _shortened(table, *OLDER[field.name])
            hashed.update(repr((field.name, table.dtype.descr, table.shape)).encode())
            hashed.update(table.tobytes())
    return hashed.hexdigest()[:LENGTH]


def _shortened(table: NDArray[Any], name: str, columns: int) -> NDArray[Any]:
    """A table with only the first columns of a field if no value of the others is known."""
    if not np.isnan(table[name][:, columns:]).all():
        return table
    kinds = [(field, table.dtype[field].base, table.dtype[field].shape) for field in table.dtype.names or ()]
    shorter = np.zeros(len(table), [(f, kind, (columns,) if f == name else shape) for f, kind, shape in kinds])
    for field in shorter.dtype.names or ():
        shorter[field] = table[field][:, :columns] if field == name else table[field]
    return shorter


def canonical(table: NDArray[Any]) -> NDArray[Any]:
    """The numbers in little-endian order with a single NaN, because the bits of NaN depend on the processor."""
    plain = table.astype(table.dtype.newbyteorder("<"))
    for column in [plain[name] for name in plain.dtype.names] if plain.dtype.names else [plain]:
        if column.dtype.kind == "f":
            column[np.isnan(column)] = np.nan
    return plain
