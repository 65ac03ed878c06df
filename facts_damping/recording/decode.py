"""Decodes CDR messages to series in order of their ticks; decoded_tables makes tables of them."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from facts_damping.errors import RecordingError
from facts_damping.recording.columns import Block, blocks, kept
from facts_damping.recording.fields import check_fields
from facts_damping.recording.schemas import parse_schema
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray
    from rosbags.interfaces.typing import Typesdict

    from facts_damping.recording.bagfile import TopicInfo

NO_FIELDS: Any = [("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))]  # of a type without any


class Series(NamedTuple):
    """Messages of one topic in order of ticks; the rows of the blocks are indices into `ticks`."""

    topic: str
    ticks: NDArray[np.int64]
    blocks: list[Block]


def decode(topic: TopicInfo, data: Sequence[bytes], notes: list[str]) -> list[Block]:
    """Decode a topic's messages by the schema stored with it. Invalid ones are left out and counted in `notes`.

    Raises RecordingError if the schema is unreadable or lacks a field that is needed.
    """
    if not data:  # then an older schema does no harm
        return []
    try:
        decoded, odd = blocks(data, _definitions(topic.message_type, topic.schema), topic.message_type)
    except KeyError as error:
        raise RecordingError(f"{topic.name}: the schema of {topic.message_type} lacks {error}") from error
    if odd:
        notes.append(f"{topic.name}: {odd} messages that are no {topic.message_type} are left out")
    return decoded


@lru_cache(maxsize=64)
def _definitions(message_type: str, schema: str) -> Typesdict:
    """Types of one schema, checked, and those that every schema may use without their text.

    In CDR a type without fields is one byte.
    """
    definitions = parse_schema(message_type, schema)
    check_fields(message_type, definitions)
    for name, (constants, fields) in definitions.items():
        names = [field for field, _ in fields]
        if len(set(names)) < len(names):
            raise RecordingError(f"schema of {message_type}: {name}: a field given twice; allowed: each once")
        definitions[name] = constants, fields or NO_FIELDS
    return {**get_typestore(Stores.EMPTY).fielddefs, **definitions}


def series(topic: str, parts: Sequence[Block], several: bool, notes: list[str]) -> Series:
    """Messages sorted by tick; of one tick only the first is kept, or all if `several`. A note counts the others."""
    count = sum(len(block.rows) for block in parts)
    ticks = np.zeros(count, np.int64)
    for block in parts:
        ticks[block.rows] = block.message.tick
    sorted_ticks, first = np.unique(ticks, return_index=True)
    again = count - len(sorted_ticks)
    if several and again:
        first = np.argsort(ticks, kind="stable")
        sorted_ticks = ticks[first]
    place = np.full(count, -1)
    place[first] = np.arange(len(first))
    if again:
        text = "all are kept" if several else "the first counts"
        notes.append(f"{topic}: {again} messages repeat a tick: {text}")
    return Series(topic, sorted_ticks, _placed(parts, place))


def select(source: Series, ticks: NDArray[np.int64]) -> Series:
    """Part of a series at the given ticks."""
    return _part(source, np.isin(source.ticks, ticks))


def between(source: Series, first: int, last: int) -> Series:
    """Part of a series from tick `first` to tick `last`, both included."""
    return _part(source, (source.ticks >= first) & (source.ticks <= last))


def _part(source: Series, keep: NDArray[np.bool_]) -> Series:
    place = np.where(keep, np.cumsum(keep) - 1, -1)
    return Series(source.topic, source.ticks[keep], _placed(source.blocks, place))


def _placed(parts: Sequence[Block], positions: NDArray[np.int64]) -> list[Block]:
    """Blocks moved to new places, in order of first appearance; messages with a negative place are left out."""
    moved = [kept(block, positions[block.rows]) for block in parts]
    return sorted((block for block in moved if len(block.rows)), key=lambda block: int(block.rows.min()))


def column(source: Series, value: Callable[[Any], NDArray[Any]], kind: type) -> NDArray[Any]:
    """A value of each message, (ticks,)."""
    values: NDArray[Any] = np.zeros(len(source.ticks), kind)
    for block in source.blocks:
        values[block.rows] = value(block.message)
    return values


def names_of(parts: Iterable[Block], entries: str, name: str) -> list[str]:
    """Values of the field `name` in the list `entries` of the messages, in order of appearance."""
    return list(dict.fromkeys(getattr(entry, name) for block in parts for entry in getattr(block.message, entries)))


def time_ns(time: Any) -> NDArray[np.int64]:
    """builtin_interfaces/Time in ns."""
    return np.asarray(np.asarray(time.sec, np.int64) * NANOSECONDS + time.nanosec, np.int64)


def place(name: str) -> int:
    """Index in the run of a controller (`controller_0_LLC`), or of the controller that a node serves.

    0 for other names.
    """
    number = re.fullmatch(r"(?:controller|identifier|supervisor)_(\d+)_.*", name)
    return int(number[1]) if number else 0
