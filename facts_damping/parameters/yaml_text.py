"""YAML 1.2 as text: read and written.

PyYAML's plain words are those of YAML 1.1, where `no` is false, `1e-3` a text and `12:30` a number. Here they are those
of the core schema of YAML 1.2; the rest of PyYAML, which is written in C, reads ten times as fast as Python can.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml

UNREADABLE = (yaml.YAMLError, ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)

TEXT, MAPPING_END, SEQUENCE_END = "tag:yaml.org,2002:str", yaml.MappingEndEvent(), yaml.SequenceEndEvent()
ODD = object()  # no value
DEEPEST = 50  # levels of nesting
MAX_VALUES = 1_000_000
MAX_ENTRIES = 20_000  # tables in a list: buses of a grid, events of a scenario

# Plain words that are no text.
CORE_SCHEMA = {
    "bool": (r"true|True|TRUE|false|False|FALSE", "tTfF"),
    "int": (r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", "-+0123456789"),
    "float": (
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+.0123456789",
    ),
    "merge": (r"<<", "<"),
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
}


class _Loader(yaml.CSafeLoader):
    """Reads YAML 1.2; a key that stands twice is an error."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        """A mapping whose keys are told apart before any is merged in."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if key.tag not in ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"):
                shown = repr(key.value[:20]) if isinstance(key, yaml.ScalarNode) else "a collection"
                problem = f"key {shown} is not text"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
            name = (key.tag, str(key.value))
            if name in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key '{key.value}' stands twice", key.start_mark)
            seen.add(name)
        return super().construct_mapping(node, deep)


class PlainDumper(yaml.CSafeDumper):
    """Writes mappings, lists and values as they come, in a third of the time; what stands in two places, twice."""

    def represent(self, data: Any) -> None:
        """Write a document."""
        self.emit(yaml.DocumentStartEvent(explicit=False))
        self._write(data)
        self.emit(yaml.DocumentEndEvent(explicit=False))

    def _write(self: Any, data: Any) -> None:
        if type(data) is str:
            self.emit(_scalar(self.__class__, TEXT, data))
        elif type(data) is dict:
            self.emit(yaml.MappingStartEvent(None, None, True, flow_style=self.default_flow_style))
            for name, value in data.items():
                self._write(name)
                self._write(value)
            self.emit(MAPPING_END)
        elif type(data) in (list, tuple):
            self.emit(yaml.SequenceStartEvent(None, None, True, flow_style=self.default_flow_style))
            for value in data:
                self._write(value)
            self.emit(SEQUENCE_END)
        else:
            node = self.yaml_representers.get(type(data), self.yaml_representers[None])(self, data)
            self.emit(_scalar(self.__class__, node.tag, node.value))


@lru_cache(maxsize=4096)
def _scalar(dumper: Any, tag: str, text: str) -> yaml.ScalarEvent:
    """A value, quoted if as a plain word it would be read as one of another kind."""
    words = dumper.yaml_implicit_resolvers.get(text[:1], ())
    implied = next((word_tag for word_tag, pattern in words if pattern.match(text)), TEXT)
    return yaml.ScalarEvent(None, tag, (implied == tag, tag == TEXT), text)


class _Dumper(PlainDumper):
    """Writes what `_Loader` reads back."""


def _integer(loader: Any, node: Any) -> int:
    """A whole number: decimal, also with zeros before it, octal with 0o, hexadecimal with 0x."""
    text = str(loader.construct_scalar(node))
    return int(text, 0) if text[:2] in ("0o", "0x") else int(text)


for _class in (_Loader, _Dumper):
    _class.yaml_implicit_resolvers = {}
    for _tag, (_pattern, _first) in CORE_SCHEMA.items():
        _class.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), list(_first))
_Loader.add_constructor("tag:yaml.org,2002:int", _integer)


def parse(text: str) -> Any:
    """Content of YAML text. Raises one of UNREADABLE where it is none; damaged text has more errors than YAML's own."""
    content = _read(text)
    return yaml.load(text, _Loader) if content is ODD else content  # noqa: S506 (a safe loader)


@dataclass
class _Begun:
    """A collection that has begun."""

    content: Any
    anchor: str | None = None
    values: int = 0  # so far
    tables: int = 0  # collections in it so far
    key: Any = ODD  # whose value comes next

    def add(self, value: Any) -> bool:
        """Add an entry, or a key or its value; false where `_Loader` must: for a key that is odd or stands twice."""
        if type(self.content) is list:
            self.content.append(value)
        elif self.key is not ODD:
            self.content[self.key], self.key = value, ODD
        elif type(value) is str and value not in self.content:
            self.key = value
        else:
            return False
        return value is not ODD


def _read(text: str) -> Any:
    """Content of YAML text, in half of `_Loader`'s time; ODD where that must read it: tags, anchors, keys at fault.

    Before anything is made of it, refuses what is nested too deep, or too large once its aliases are written out.
    """
    sizes: dict[str, int] = {}  # of what has an anchor
    begun, plain = [_Begun([])], True  # collections around the event
    for event in yaml.parse(text, _Loader):
        size, anchor, value = 0, None, ODD
        if isinstance(event, yaml.ScalarEvent):
            size, anchor, value = 1, event.anchor, _word(event.value) if event.implicit[0] else event.value
        elif isinstance(event, yaml.CollectionStartEvent):
            begun[-1].tables += 1
            begun.append(_Begun({} if isinstance(event, yaml.MappingStartEvent) else [], event.anchor, values=1))
        elif isinstance(event, yaml.CollectionEndEvent):
            ended = begun.pop()
            size, anchor, value = ended.values, ended.anchor, ended.content
        elif isinstance(event, yaml.AliasEvent):
            size = sizes.get(event.anchor or "", 1)
        if anchor is not None:
            sizes[anchor] = size
        begun[-1].values += size
        if len(begun) > DEEPEST:
            raise _too_much(event, f"{DEEPEST} levels")
        if begun[-1].values > MAX_VALUES:
            raise _too_much(event, f"{MAX_VALUES} values, aliases written out")
        if begun[-1].tables > MAX_ENTRIES:
            raise _too_much(event, f"{MAX_ENTRIES} tables in a list")
        special = getattr(event, "tag", None) is not None or getattr(event, "anchor", None) is not None
        plain = plain and not special and (size == 0 or begun[-1].add(value))
    return begun[0].content[0] if plain and len(begun[0].content) == 1 else ODD


@lru_cache(maxsize=4096)
def _word(text: str) -> Any:
    """Value of a plain word; ODD where it is none, as `<<`."""
    tags = (tag for tag, pattern in _Loader.yaml_implicit_resolvers.get(text[:1], ()) if pattern.match(text))
    tag = next(tags, TEXT)
    try:
        return _Loader.yaml_constructors[tag](_Loader(""), yaml.ScalarNode(tag, text))
    except UNREADABLE:
        return ODD


def _too_much(event: Any, limit: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=f"more than {limit}", problem_mark=event.start_mark)


def dump(content: Any, *, flow: bool = False) -> str:
    """Content as YAML text; `flow`: on one line."""
    text: str = yaml.dump(
        content,
        Dumper=_Dumper,
        default_flow_style=flow,
        width=1_000_000 if flow else 80,
        sort_keys=False,
        allow_unicode=True,
    )
    return text.removesuffix("...\n")
