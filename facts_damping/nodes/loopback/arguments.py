"""Arguments of ROS 2 on a command line: what a node is called, where its topics lead, its parameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PARAMETER, REMAPPING, FILE = ("-p", "--param"), ("-r", "--remap"), ("--params-file",)


@dataclass
class Arguments:
    """Rules in their order, each for a node by name, or for all (None)."""

    remaps: list[tuple[str | None, str, str]] = field(default_factory=list)
    parameters: list[tuple[str | None, str, Any]] = field(default_factory=list)


def parse(given: Sequence[str]) -> Arguments:
    """Those between `--ros-args` and `--`; others are the program's own."""
    found, ours, words = Arguments(), False, iter(given)
    for word in words:
        if word in ("--ros-args", "--"):
            ours = word == "--ros-args"
        elif ours and word in (*PARAMETER, *REMAPPING):
            rule = next(words, "")
            left, separator, right = rule.partition(":=")
            if not separator:
                raise RuntimeError(f"Couldn't parse argument: '{word} {rule}'")
            node, name = _of_a_node(left)
            if word in PARAMETER:
                found.parameters.append((node, name, yaml.safe_load(right)))
            else:
                found.remaps.append((node, name, right))
        elif ours and word in FILE:
            found.parameters += _from_file(Path(next(words, "")))
    return found


def _of_a_node(name: str) -> tuple[str | None, str]:
    node, separator, rest = name.partition(":")
    return (node, rest) if separator else (None, name)


def _from_file(path: Path) -> Iterator[tuple[str | None, str, Any]]:
    """Parameters of a file: a table for each node, or for any by a wildcard."""
    for node, content in (yaml.safe_load(path.read_text(encoding="utf-8")) or {}).items():
        for name, value in _flat(content.get("ros__parameters", {})):
            yield None if set(node) <= set("/*") else node.lstrip("/"), name, value


def _flat(content: dict[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value
