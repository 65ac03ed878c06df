"""The digest of a run: a number that two runs share if all their signals are the same, to the last bit."""

from __future__ import annotations

from dataclasses import fields
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from facts_damping.signals import Record

LENGTH = 16  # hexadecimal digits that are shown and stored
NAMES = ("stations", "machine_names", "device_names", "controller_names")  # what columns of the signals are of


def digest(record: Record) -> str:
    """Hexadecimal digits of the SHA-256 of a record's arrays, with their names, fields and shapes, and `NAMES`.

    What does not follow from the run is left out: the text of the configuration, what nodes refused, who published.
    """
    told = sha256(repr([list(getattr(record, name)) for name in NAMES]).encode())
    for one in fields(record):
        value = getattr(record, one.name)
        if isinstance(value, np.ndarray):
            table = canonical(value)
            told.update(repr((one.name, table.dtype.descr, table.shape)).encode())
            told.update(table.tobytes())
    return told.hexdigest()[:LENGTH]


def canonical(table: NDArray[Any]) -> NDArray[Any]:
    """The same numbers, little-endian and with one NaN: which of its bits are set depends on the processor."""
    found = table.astype(table.dtype.newbyteorder("<"))
    for column in [found[name] for name in found.dtype.names] if found.dtype.names else [found]:
        if column.dtype.kind == "f":
            column[np.isnan(column)] = np.nan
    return found
