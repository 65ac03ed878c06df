"""Compiled conversion between rows of an array and the entries of a message (plain CDR, little-endian).

A row consists of words of eight bytes (DELIVERY, SETPOINT). A `PackingPlan` lists the fields of a message in order as
steps: kind of field, column of the row, table of names. A message consists of a head, entries, and a signature (its
length and its bytes).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from facts_damping.compiling import entry_point, inlined
from facts_damping.compiling.structs import Array, Int1, Int2, Struct
from facts_damping.signals import NANOSECONDS

Bytes = Annotated[NDArray[np.uint8], Array(np.uint8, 1)]
TIME, NUMBER, NEAREST, COUNT, STATUS, FLAG, NAME, LABEL, FREE = range(9)  # kinds of steps
FORMAT, NAMES = -1, -2  # error codes
START, TICK, SENDER, FRESH, ENTRIES, SIGNATURE, BEGIN, LATEST, NOTHING = range(9)  # columns of a head
PADDING = 7 + 3  # most bytes of padding: to a multiple of eight, and of four


class PackingPlan(Struct):
    """Layout of the messages of one type."""

    head: Int2  # (steps, 3): step, column, table
    entry: Int2
    names: Annotated[NDArray[np.uint8], Array(np.uint8, 3)]  # (tables, names, bytes), zero-terminated
    lengths: Int2  # (tables, names): bytes of each name with its zero; 0: no name
    frame_rate: int  # ticks/s


class Stream(Struct):
    """Bytes of a message after its encapsulation, viewed as numbers of each format."""

    octets: Bytes
    status: Annotated[NDArray[np.uint16], Array(np.uint16, 1)]
    seconds: Annotated[NDArray[np.int32], Array(np.int32, 1)]
    counts: Annotated[NDArray[np.uint32], Array(np.uint32, 1)]
    words: Int1


@inlined
def aligned(at: int, size: int) -> int:
    """`at`, rounded up to a multiple of `size`."""
    return (at + size - 1) // size * size


@inlined
def size_of(step: int) -> int:
    """Alignment of a step's field, bytes, which is also its size unless it is a time; for a string: of its length."""
    if step in (NUMBER, NEAREST):
        return 8
    if step == STATUS:
        return 2
    return 1 if step == FLAG else 4


@inlined
def put(plan: PackingPlan, steps: Int2, stream: Stream, row: Int1, begin: int, epoch_ns: int) -> int:
    """Write a row from `begin` on. Returns the position after it."""
    at = begin
    for s in range(steps.shape[0]):
        step, value, table = steps[s, 0], row[steps[s, 1]], steps[s, 2]
        place = aligned(at, size_of(step))
        while at < place:
            stream.octets[at] = 0
            at += 1
        if step == TIME:
            time = value + epoch_ns
            stream.seconds[at // 4] = time // NANOSECONDS
            stream.counts[at // 4 + 1] = time - time // NANOSECONDS * NANOSECONDS
            at += 8
        elif step == NUMBER:
            stream.words[at // 8] = value
            at += 8
        elif step == NEAREST:
            stream.words[at // 8] = max(0, (value * plan.frame_rate + NANOSECONDS // 2) // NANOSECONDS)
            at += 8
        elif step == COUNT:
            stream.counts[at // 4] = value
            at += 4
        elif step == STATUS:
            stream.status[at // 2] = value
            at += 2
        elif step == FLAG:
            stream.octets[at] = value
            at += 1
        else:
            length = plan.lengths[table, value]
            stream.counts[at // 4] = length
            for i in range(length):
                stream.octets[at + 4 + i] = plan.names[table, value, i]
            at += 4 + length
    return at


@entry_point
def write(plan: PackingPlan, stream: Stream, head: Int1, rows: Int2, epoch_ns: int) -> int:
    """Write a message up to and including the length of its signature. Returns where the signature begins.

    `epoch_ns` is added to times.
    """
    at = put(plan, plan.head, stream, head, 0, epoch_ns)
    for i in range(rows.shape[0]):
        begin = aligned(at, 4)
        while at < begin:
            stream.octets[at] = 0
            at += 1
        at = put(plan, plan.entry, stream, rows[i], begin, epoch_ns)
    while at % 4:
        stream.octets[at] = 0
        at += 1
    stream.counts[at // 4] = head[SIGNATURE]
    return at + 4


@inlined
def same(plan: PackingPlan, table: int, name: int, stream: Stream, at: int, length: int) -> bool:
    """Whether a string of the stream equals a name of a table."""
    if plan.lengths[table, name] != length:
        return False
    equal = 0
    while equal < length and plan.names[table, name, equal] == stream.octets[at + equal]:
        equal += 1
    return equal == length


@inlined
def found(plan: PackingPlan, table: int, stream: Stream, at: int, length: int) -> int:
    """Index of a string of the stream in a table of names; -1: none."""
    for name in range(plan.lengths.shape[1]):
        if same(plan, table, name, stream, at, length):
            return name
    return -1


@inlined
def get(plan: PackingPlan, steps: Int2, stream: Stream, size: int, row: Int1, begin: int, epoch_ns: int) -> int:
    """Read a row from `begin` on, of a stream of `size` bytes. Returns the position after it, or an error code."""
    at, label, label_step = begin, 0, -1
    for s in range(steps.shape[0]):
        step, column, table = steps[s, 0], steps[s, 1], steps[s, 2]
        at = aligned(at, size_of(step))
        end = at + (8 if step == TIME else size_of(step))
        if end > size:
            return FORMAT
        if step == TIME:
            row[column] = stream.seconds[at // 4] * NANOSECONDS + stream.counts[at // 4 + 1] - epoch_ns
        elif step == NUMBER:
            row[column] = stream.words[at // 8]
        elif step == COUNT:
            row[column] = stream.counts[at // 4]
        elif step == STATUS:
            row[column] = stream.status[at // 2]
        elif step == FLAG:
            row[column] = stream.octets[at]
        elif step != NEAREST:
            length = int(stream.counts[at // 4])
            if length > size - end or length == 0 or stream.octets[end + length - 1] != 0:
                return FORMAT
            if step == NAME:
                row[column] = found(plan, table, stream, end, length)
                if row[column] < 0:
                    return NAMES
            elif step == LABEL:
                label, label_step = at, s
            end += length
        at = end
    if label_step >= 0:
        name, table = row[steps[label_step, 1]], steps[label_step, 2]
        if not same(plan, table, name, stream, label + 4, int(stream.counts[label // 4])):
            return NAMES
    return at


@entry_point
def read(plan: PackingPlan, stream: Stream, size: int, head: Int1, rows: Int2, epoch_ns: int) -> int:
    """Read a message of `size` bytes into `head` and `rows`. Returns the number of entries, or an error code.

    `head[BEGIN]` is where the signature begins; `head[LATEST]` the latest time in the entries, at least 0. Their first
    time does not count: it is the time of measurement, which a wrong clock may give.
    """
    at = get(plan, plan.head, stream, size, head, 0, epoch_ns)
    if at < 0:
        return at
    if head[ENTRIES] > rows.shape[0]:
        return FORMAT
    head[LATEST] = 0
    for i in range(head[ENTRIES]):
        at = get(plan, plan.entry, stream, size, rows[i], aligned(at, 4), epoch_ns)
        if at < 0:
            return at
        for s in range(1, plan.entry.shape[0]):
            if plan.entry[s, 0] == TIME:
                head[LATEST] = max(head[LATEST], rows[i, plan.entry[s, 1]])
    at = aligned(at, 4)
    if at + 4 > size:
        return FORMAT
    head[SIGNATURE], head[BEGIN] = stream.counts[at // 4], at + 4
    left = size - head[BEGIN] - head[SIGNATURE]
    return head[ENTRIES] if 0 <= left <= PADDING else FORMAT


@entry_point
def take(data: Bytes, content: Bytes, shape: Int1, names: Bytes) -> bool:
    """Copy the first `len(content)` bytes of `data` to `content` if those at `shape` equal `names`; return whether.

    Padding may follow (rclpy leaves room for the alignment of an empty sequence's numbers).
    """
    if not content.shape[0] <= data.shape[0] <= content.shape[0] + PADDING:
        return False
    for i in range(shape.shape[0]):
        if data[shape[i]] != names[i]:
            return False
    for i in range(content.shape[0]):
        content[i] = data[i]
    return True
