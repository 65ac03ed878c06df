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
            hashed.update(repr((field.name, table.dtype.descr, table.shape)).encode())
            hashed.update(table.tobytes())
    return hashed.hexdigest()[:LENGTH]


def canonical(table: NDArray[Any]) -> NDArray[Any]:
    """The numbers in little-endian order with a single NaN, because the bits of NaN depend on the processor."""
    plain = table.astype(table.dtype.newbyteorder("<"))
    for column in [plain[name] for name in plain.dtype.names] if plain.dtype.names else [plain]:
        if column.dtype.kind == "f":
            column[np.isnan(column)] = np.nan
    return plain
