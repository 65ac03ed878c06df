"""Messages by our names are read where their schema has what is read, and as it is read; else a line says why not."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from facts_damping.errors import RecordingError
from facts_damping.recording import RecordingWriter, load, schema_text
from facts_damping.recording.bagfile import TopicInfo
from facts_damping.recording.decode import decode
from facts_damping.recording.fields import FIELDS, written
from facts_damping.recording.reader import KINDS
from facts_damping.recording.scan import scan
from facts_damping.recording.schemas import SEPARATOR
from facts_damping.signals import ESTIMATE
from tests.nodes.graphs import assert_same

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from facts_damping.record import Record

TYPES = sorted({message_type for message_type, _ in KINDS.values()})
# A number as another one, wider and narrower, as text, as a message, in a sequence or an array; text as numbers.
OTHERS = [
    *("float64", "float32", "uint64", "int64", "uint32", "int8", "bool", "string", "string<=9", "std_msgs/msg/Header"),
    *("float64[]", "float64[2]", "float64[<=3]", "uint64[]", "string[]", "bool[1]", "std_msgs/msg/Header[]"),
]


@pytest.mark.parametrize("name", TYPES)
def test_fields_that_are_read_are_in_the_message_definitions(name: str) -> None:
    for type_name, (_, fields) in get_types_from_msg(schema_text(name), name).items():
        assert FIELDS[type_name].items() <= {field: written(kind) for field, kind in fields}.items()


def changed(text: str, owner: str, field: str, other: str | None) -> str:
    """A schema with another type of a field of one of its messages, or without the field."""
    line = re.compile(rf"^\S+( +{field}\b)", re.MULTILINE)
    head, separator, definition = text.partition(f"{SEPARATOR}\nMSG: {owner.replace('/msg/', '/')}\n")
    parts = [head + separator, definition] if separator else ["", text]
    assert line.search(parts[1])
    return parts[0] + line.sub(rf"{other}\1" if other else r"#\1", parts[1], count=1)


READ = [(owner, field) for owner in FIELDS for field in FIELDS[owner]]
FIRST = {FIELDS[owner][field]: (owner, field) for owner, field in reversed(READ)}  # field of each type


@pytest.mark.parametrize(("owner", "field"), READ)
def test_field_of_another_type_is_refused(owner: str, field: str) -> None:
    """The first field of each type with all others, the rest with one each by turns, and without the field."""
    name = next(
        name_of_type for name_of_type in TYPES if owner in get_types_from_msg(schema_text(name_of_type), name_of_type)
    )
    allowed, turn = FIELDS[owner][field], READ.index((owner, field)) % len(OTHERS)
    others = OTHERS if FIRST[allowed] == (owner, field) else OTHERS[turn : turn + 1]
    for other in [None, *(other_type for other_type in others if other_type != allowed)]:
        topic = TopicInfo("/topic", name, changed(schema_text(name), owner, field, other), "", "")
        with pytest.raises(RecordingError) as caught:
            decode(topic, [bytes(4)], [])
        problem = f"{owner}.{field}: {other or 'no such field'} given; allowed: {allowed}"
        assert str(caught.value) == f"schema of {name}: {problem}"
        assert decode(topic, [], []) == []


@pytest.mark.parametrize(
    ("owner", "field", "other"),
    [("PlantState", "tick", "float64"), ("PmuFrame", "speed_deviation_pu", "uint64"), ("PlantState", "machines", None)],
)
def test_recording_of_other_fields_is_refused_in_a_line(
    tmp_path: Path, random_record: Callable[..., Record], written: Any, owner: str, field: str, other: str | None
) -> None:
    """Its bytes would be read as other numbers: eight of a tick as a fraction, or the reverse."""
    written(random_record(21, 3), tmp_path / "run")
    content = scan(tmp_path / "run")
    with RecordingWriter(tmp_path / "other", content.configuration) as writer:
        for topic in content.topics.values():
            contains = any(line.endswith(f"/{owner}") for line in (topic.message_type, *topic.schema.splitlines()))
            text = changed(topic.schema, f"facts_damping_msgs/msg/{owner}", field, other) if contains else topic.schema
            writer.copy_topic(topic._replace(schema=text))
        for message in content.messages:
            writer.write(message.topic, message.data, message.log_ns, message.publish_ns)
    said = (
        rf"/other: schema of facts_damping_msgs/msg/\w+: facts_damping_msgs/msg/{owner}\.{field}: .* given; allowed: "
    )
    with pytest.raises(RecordingError, match=said):
        load(tmp_path / "other")


def with_estimates(record: Record) -> Record:
    """A record with what an identifier of two signals and two devices estimates."""
    rows = np.zeros(4 * len(record.time_ns), ESTIMATE)
    for i, field in enumerate(("jacobian", "prediction", "error", "ahead", "change")):
        rows[field] = np.arange(len(rows)) // (1 if field == "jacobian" else 2) + i
    rows["tick"], rows["controller"] = np.arange(len(rows)) // 4, 2
    rows["signal"], rows["device"] = np.arange(len(rows)) // 2 % 2, np.arange(len(rows)) % 2
    rows["ahead"] = 0.5
    record.estimates.resize(len(rows), refcheck=False)
    record.estimates[:] = rows
    return record


def test_fields_that_are_not_read_may_lack(
    tmp_path: Path, messages: Any, random_record: Callable[..., Record], written: Any
) -> None:
    """So the table of what is read lacks nothing, and a recording of another version is read where it can be."""
    record = with_estimates(random_record(22, 4))
    written(record, tmp_path / "whole")
    content = scan(tmp_path / "whole")
    texts = {type_name: "".join(f"{kind} {name}\n" for name, kind in FIELDS[type_name].items()) for type_name in FIELDS}
    schemas = {
        name: "".join(
            [
                texts[name],
                *(f"{SEPARATOR}\nMSG: {type_name}\n{text}" for type_name, text in texts.items() if type_name != name),
            ]
        )
        for name in TYPES
    }
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(schemas[TYPES[0]], TYPES[0]))
    with RecordingWriter(tmp_path / "slim", content.configuration) as writer:
        for topic in content.topics.values():
            writer.add_topic(topic.name, topic.message_type, schema=schemas[topic.message_type])
        for message_raw in content.messages:
            message_type = content.topics[message_raw.topic].message_type
            message = slim(store, messages.store.deserialize_cdr(message_raw.data, message_type))
            writer.write(
                message_raw.topic,
                bytes(store.serialize_cdr(message, message_type)),
                message_raw.log_ns,
                message_raw.publish_ns,
            )
    assert_same(load(tmp_path / "slim"), load(tmp_path / "whole"))
    assert len(load(tmp_path / "slim").estimates) == len(record.estimates)


def slim(store: Any, value: Any) -> Any:
    """A message, and those in it, with nothing but the fields that are read."""
    if isinstance(value, list):
        return [slim(store, member) for member in value]
    name = getattr(value, "__msgtype__", None)
    if name is None:
        return value
    return store.types[name](**{field: slim(store, getattr(value, field)) for field in FIELDS[name]})


# Schemas that rosbags accepts, too, as bytes of one message; what of it is read.
HEAD, LINE = b"\x00\x01\x00\x00", f"\n{SEPARATOR}\nMSG: "
SCHEMAS = {
    "a time without its definition": ("uint64 tick\nbuiltin_interfaces/Time stamp\n", "<QiI", (7, 5, 6)),
    "a type without fields": (
        f"uint64 tick\nstd_msgs/Empty empty\nuint32 last{LINE}std_msgs/Empty\n",
        "<QBxxxI",
        (7, 0, 9),
    ),
}


@pytest.mark.parametrize("schema", SCHEMAS)
def test_schemas_with_built_in_and_empty_types_are_read(schema: str) -> None:
    text, form, values = SCHEMAS[schema]
    notes = list[str]()
    (block,) = decode(TopicInfo("/t", "my/msg/X", text, "", ""), [HEAD + struct.pack(form, *values)], notes)
    assert (block.message.tick[0], notes) == (7, [])
    last = block.message.last if hasattr(block.message, "last") else block.message.stamp.nanosec
    assert last[0] == values[-1]


def test_schema_with_a_field_twice_is_refused() -> None:
    with pytest.raises(RecordingError, match="my/msg/X: a field given twice; allowed: each once"):
        decode(TopicInfo("/t", "my/msg/X", "uint64 tick\nuint64 tick\n", "", ""), [HEAD + bytes(16)], [])
