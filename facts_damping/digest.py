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
    for one in fields(record):
        value = getattr(record, one.name)
        if isinstance(value, np.ndarray):
            left_out = [name for name in YOUNGER.get(one.name, []) if np.isnan(value[name]).all()]
            table = canonical(drop_fields(value, left_out, usemask=False) if left_out else value)
            hashed.update(repr((one.name, table.dtype.descr, table.shape)).encode())
            hashed.update(table.tobytes())
    return hashed.hexdigest()[:LENGTH]


def canonical(table: NDArray[Any]) -> NDArray[Any]:
    """The numbers in little-endian order with a single NaN, because the bits of NaN depend on the processor."""
    found = table.astype(table.dtype.newbyteorder("<"))
    for column in [found[name] for name in found.dtype.names] if found.dtype.names else [found]:
        if column.dtype.kind == "f":
            column[np.isnan(column)] = np.nan
    return found
