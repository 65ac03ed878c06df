"""Rows of a table, between arrays and the places that their numbers have in a message; compiled.

A row is of words of eight bytes (DELIVERY, SETPOINT). From its column `first` on come times in ns, of which a message
has seconds and nanoseconds, then numbers, which a message has as they are, bit for bit. `places`, (rows, numbers of a
row in the message): where these stand, in the same order, among the stream's numbers of their format.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import entry_point
from facts_damping.compiling.structs import Array, Int1, Int2
from facts_damping.signals import NANOSECONDS, Deliveries

Bytes = Annotated[NDArray[np.uint8], Array(np.uint8, 1)]
Seconds = Annotated[NDArray[np.int32], Array(np.int32, 1)]
Nanoseconds = Annotated[NDArray[np.uint32], Array(np.uint32, 1)]
Counts = Annotated[NDArray[np.uint64], Array(np.uint64, 1)]
Statuses = Annotated[NDArray[np.uint16], Array(np.uint16, 1)]
PADDING = 7 + 3  # bytes: up to a multiple of eight, and of four


@entry_point
def pack(
    words: Int2,
    first: int,
    times: int,
    places: Int2,
    seconds: Seconds,
    nanoseconds: Nanoseconds,
    numbers: Int1,
    epoch_ns: int,
) -> None:
    """Put rows into a message: `words`, (rows, columns), into the stream's numbers of three formats.

    `epoch_ns` is added to their times.
    """
    for i in range(places.shape[0]):
        for j in range(times):
            time = words[i, first + j] + epoch_ns
            whole = time // NANOSECONDS
            seconds[places[i, 2 * j]] = whole
            nanoseconds[places[i, 2 * j + 1]] = time - whole * NANOSECONDS
        for j in range(places.shape[1] - 2 * times):
            numbers[places[i, 2 * times + j]] = words[i, first + times + j]


@entry_point
def unpack(
    words: Int2,
    first: int,
    times: int,
    places: Int2,
    seconds: Seconds,
    nanoseconds: Nanoseconds,
    numbers: Int1,
    epoch_ns: int,
) -> int:
    """Take rows out of a message, the same way back.

    Returns the latest of their times but the first (of measurement, which a wrong clock gives), 0 if none is later.
    """
    latest = 0
    for i in range(places.shape[0]):
        for j in range(times):
            time = seconds[places[i, 2 * j]] * NANOSECONDS + nanoseconds[places[i, 2 * j + 1]] - epoch_ns
            words[i, first + j] = time
            latest = max(latest, time if j > 0 else 0)
        for j in range(places.shape[1] - 2 * times):
            words[i, first + times + j] = numbers[places[i, 2 * times + j]]
    return latest


@entry_point
def mark(
    rows: Deliveries,
    frame_rate: int,
    places: Int2,
    ticks: Counts,
    status: Statuses,
) -> None:
    """Put into a message of frames (DELIVERY) the tick next to each one's time of measurement, and its status.

    `places`: (rows, 2), of tick and status.
    """
    for i in range(places.shape[0]):
        row = rows[i]
        ticks[places[i, 0]] = max(0, (row.measured_ns * frame_rate + NANOSECONDS // 2) // NANOSECONDS)
        status[places[i, 1]] = row.status


@entry_point
def take(data: Bytes, kept: Bytes, shape: Int1, names: Bytes) -> bool:
    """Take over a message (the first `len(kept)` bytes of `data`) if its bytes at `shape` are `names`.

    What pads it at its end may follow (rclpy leaves room before the numbers of a sequence that has none).
    """
    if not kept.shape[0] <= data.shape[0] <= kept.shape[0] + PADDING:
        return False
    for i in range(shape.shape[0]):
        if data[shape[i]] != names[i]:
            return False
    for i in range(kept.shape[0]):
        kept[i] = data[i]
    return True
