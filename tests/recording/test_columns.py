"""Messages decoded by the column are those that rosbags decodes one by one."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from facts_damping.recording import schema_text
from facts_damping.recording.columns import FORMATS, PASSES, Block, blocks, kept
from facts_damping.recording.reader import KINDS

if TYPE_CHECKING:
    from collections.abc import Sequence

MIXED = "test_msgs/msg/Mixed"
DEFINITION = """
bool[] flags
string name
uint16 status
float64[] values
string[] names
builtin_interfaces/Time[2] times
int8 last
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


@pytest.fixture(scope="module")
def store() -> Any:
    store_of_types = get_typestore(Stores.EMPTY)
    store_of_types.register(get_types_from_msg(DEFINITION, MIXED))
    return store_of_types


def random_message(store: Any, random: np.random.Generator) -> Any:
    time = store.types["builtin_interfaces/msg/Time"]
    word = "".join(random.choice(list("ab"), random.integers(0, 4)))
    return store.types[MIXED](
        flags=random.integers(0, 2, random.integers(0, 3)).astype(bool),
        name=word,
        status=int(random.integers(0, 2**16)),
        values=random.normal(size=random.integers(0, 3)),
        names=[word] * int(random.integers(0, 3)),
        times=[time(sec=int(random.integers(-9, 9)), nanosec=int(random.integers(0, 10**9))) for _ in range(2)],
        last=int(random.integers(-128, 128)),
    )


def at(message: Any, place: int) -> dict[str, Any]:
    """The message at a place of a block."""
    return {
        "flags": [bool(flag[place]) for flag in message.flags],
        "name": message.name,
        "status": int(message.status[place]),
        "values": [float(number[place]) for number in message.values],
        "names": message.names,
        "times": [(int(stamp.sec[place]), int(stamp.nanosec[place])) for stamp in message.times],
        "last": int(message.last[place]),
    }


def plain(message: Any) -> dict[str, Any]:
    """The same of a message of rosbags."""
    fields = {name: getattr(message, name) for name in ("name", "status", "last")}
    lists = {name: list(getattr(message, name)) for name in ("flags", "values", "names")}
    return {**fields, **lists, "times": [(stamp.sec, stamp.nanosec) for stamp in message.times]}


def listed(decoded: Sequence[Block], count: int) -> list[Any]:
    """Messages of all blocks by their places."""
    messages: list[Any] = [None] * count
    for block in decoded:
        for i, row in enumerate(block.rows.tolist()):
            assert messages[row] is None
            messages[row] = at(block.message, i)
    return messages


@pytest.mark.parametrize("little_endian", [True, False])
def test_messages_of_many_layouts(store: Any, little_endian: bool) -> None:
    random = np.random.default_rng(3)
    sent = [random_message(store, random) for _ in range(1500)]
    data = [bytes(store.serialize_cdr(message, MIXED, little_endian=little_endian)) for message in sent]
    decoded, odd = blocks(data, store.fielddefs, MIXED)
    assert odd == 0
    assert len(decoded) > 2 * PASSES
    assert len(decoded) < len(sent) / 2
    assert listed(decoded, len(sent)) == [plain(message) for message in sent]
    firsts = [int(block.rows[0]) for block in decoded]
    assert firsts == sorted(firsts)


def test_number_is_in_the_order_of_this_machine(store: Any) -> None:
    message = random_message(store, np.random.default_rng(4))
    data = bytes(store.serialize_cdr(message, MIXED, little_endian=sys.byteorder != "little"))
    (block,), _ = blocks([data, data], store.fielddefs, MIXED)
    assert block.message.status.dtype.isnative
    assert block.message.status.tolist() == [message.status] * 2


def test_messages_are_left_out_and_moved(store: Any) -> None:
    random = np.random.default_rng(5)
    sent = [random_message(store, random) for _ in range(200)]
    data = [bytes(store.serialize_cdr(message, MIXED)) for message in sent]
    place = np.where(np.arange(200) % 3 == 0, np.arange(200) // 3, -1)
    moved = [kept(block, place[block.rows]) for block in blocks(data, store.fielddefs, MIXED)[0]]
    assert listed([block for block in moved if len(block.rows)], 67) == [plain(message) for message in sent[::3]]


def test_cut_and_foreign_bytes_are_left_out(store: Any) -> None:
    message = random_message(store, np.random.default_rng(6))
    message.last = 1
    whole = bytes(store.serialize_cdr(message, MIXED))
    cut = [whole[:length] for length in range(len(whole.rstrip(b"\0")))]
    odd = [*cut, b"\x00\x07" + whole[2:]]
    assert blocks(odd, store.fielddefs, MIXED) == ([], len(odd))
    mixed = [raw for place, each in enumerate(odd) for raw in ([each, whole] if place % 3 == 0 else [each])]
    decoded, left = blocks(mixed, store.fielddefs, MIXED)
    assert left == len(odd)
    assert listed(decoded, len(mixed) - left) == [plain(message)] * (len(mixed) - left)


@pytest.mark.parametrize("name", sorted({message_type for message_type, _ in KINDS.values()}))
def test_column_decoder_knows_all_field_types_of_our_messages(name: str) -> None:
    used = get_types_from_msg(schema_text(name), name)
    kinds: list[Any] = [kind for _, fields in used.values() for _, kind in fields]
    items = [what[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, what) for node, what in kinds]
    assert {what[0] for node, what in items if node == Nodetype.BASE} <= {*FORMATS, "string"}
