"""What a viewer would find in a recording, worked out from its MCAP file alone: fields by schema, values by message."""

from __future__ import annotations

import json
import re
from itertools import chain
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

from mcap.reader import make_reader
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

PLOTTED = {"Plot", "StateTransitions"}
TOPIC, PART = re.compile(r"(/[\w/]+)"), re.compile(r'\.(\w+)(?:\[(\d+|:)\])?(?:\{(\w+)=="(\w+)"\})?')


class Bag(NamedTuple):
    """Type of every topic, its messages, and the fields of every type: base type or message, whether an array."""

    types: dict[str, str]
    messages: dict[str, list[Any]]
    fields: dict[str, dict[str, tuple[str, bool]]]


def read(folder: Path) -> Bag:
    store, types = get_typestore(Stores.EMPTY), {}
    fields: dict[str, dict[str, tuple[str, bool]]] = {}
    messages: dict[str, list[Any]] = {}
    with next(folder.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert summary is not None
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            definitions = get_types_from_msg(schema.data.decode(), schema.name)
            store.register({name: of for name, of in definitions.items() if name not in store.types})
            fields |= {
                name: {field: _kind(of) for field, of in type_fields} for name, (_, type_fields) in definitions.items()
            }
            types[channel.topic], messages[channel.topic] = schema.name, []
        for of, channel, message in reader.iter_messages():
            assert of is not None
            messages[channel.topic].append(store.deserialize_cdr(message.data, of.name))
    return Bag(types, messages, fields)


def _kind(node: Any) -> tuple[str, bool]:
    kind, what = node
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _kind(what[0])[0], True
    return (what[0] if kind == Nodetype.BASE else what), False


class Found(NamedTuple):
    """What a message path leads to: its type by the schema, whether an array, the values in all messages."""

    kind: str
    array: bool
    values: list[Any]


def follow(bag: Bag, path: str) -> Found | str:
    """What a path of Foxglove leads to; else why it leads nowhere."""
    head = TOPIC.match(path)
    if head is None or head[1] not in bag.types:
        return f"{path}: no such topic"
    kind, array, values = bag.types[head[1]], False, list(bag.messages[head[1]])
    position = head.end()
    while position < len(path):
        part = PART.match(path, position)
        if part is None or array or part[1] not in bag.fields.get(kind, {}):
            return f"{path}: no such field at {path[position:]}"
        name, place, key, wanted = part.groups()
        kind, array = bag.fields[kind][name]
        values = [getattr(value, name) for value in values]
        if place is not None:
            if not array:
                return f"{path}: {name} is no array"
            array = False
            values = list(chain(*values) if place == ":" else (v[int(place)] for v in values if int(place) < len(v)))
        if key is not None:
            if key not in bag.fields.get(kind, {}):
                return f"{path}: no field {key} to choose by"
            values = [value for value in values if getattr(value, key) == wanted]
        position = part.end()
    return Found(kind, array, values) if values else f"{path}: nothing there"


def foxglove_paths(text: str) -> Iterator[tuple[str, str, str]]:
    """Type of the panel, path, label of all that a layout of Foxglove shows."""
    for name, panel in json.loads(text)["configById"].items():
        kind = name.split("!")[0]
        for curve in panel.get("paths", ()):
            yield kind, curve["value"], curve["label"]
        for key in ("topicPath", "topicToRender"):
            if key in panel:
                yield kind, panel[key], ""


def foxglove_faults(text: str, bag: Bag) -> list[str]:
    """All paths of a layout that show nothing in a recording, or not what their panel can show."""
    faults = []
    for kind, path, _ in foxglove_paths(text):
        values = follow(bag, path)
        if isinstance(values, str):
            faults.append(values)
        elif kind in PLOTTED and (values.array or values.kind in bag.fields):
            faults.append(f"{path}: no single value")
        elif kind == "Plot" and values.kind == "string" and not all(value.isdecimal() for value in values.values):
            faults.append(f"{path}: no number")
        elif kind == "Table" and not (values.array and values.kind in bag.fields):
            faults.append(f"{path}: no array of entries")
        elif kind == "DiagnosticSummary" and values.kind != "diagnostic_msgs/msg/DiagnosticArray":
            faults.append(f"{path}: no diagnostics")
    return faults


def series(bag: Bag) -> set[str]:
    """Names of all numbers over time, as PlotJuggler makes them (its ParserROS and rosx_introspection)."""
    names = set()
    for topic, messages in bag.messages.items():
        for message in messages:
            if bag.types[topic] == "diagnostic_msgs/msg/DiagnosticArray":
                for status in message.status:
                    names.add(f"{topic}/{status.name}/level")
                    names |= {f"{topic}/{status.name}/{item.key}" for item in status.values if item.value.isdecimal()}
            else:
                names |= set(_numbers(bag, bag.types[topic], topic, message))
    return names


def _numbers(bag: Bag, kind: str, here: str, value: Any) -> Iterator[str]:
    for name, (of, array) in bag.fields[kind].items():
        inner = getattr(value, name)
        for place, inner_value in ((f"[{i}]", member) for i, member in enumerate(inner)) if array else [("", inner)]:
            if of in bag.fields:
                yield from _numbers(bag, of, f"{here}/{name}{place}", inner_value)
            elif of != "string":
                yield f"{here}/{name}{place}"


def plotjuggler_curves(text: str) -> list[str]:
    return [curve.attrib["name"] for curve in ET.fromstring(text).iter("curve")]


def plotjuggler_faults(text: str, known: set[str]) -> list[str]:
    """All curves of a layout that are not in a recording."""
    return [name for name in plotjuggler_curves(text) if name not in known]
