"""Rows that installed packages add to this package's tables, by entry points (docs/extensions.md)."""

from __future__ import annotations

import importlib
from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from facts_damping.errors import InputError, one_line

if TYPE_CHECKING:
    from collections.abc import Collection
    from importlib.metadata import EntryPoint
    from types import ModuleType

PREFIX = "facts_damping."  # of entry point groups
NEEDS = {"devices": "device_kinds", "stages": "stage_kinds", "stage_kinds": "stages"}  # fields and behaviour of a kind
GROUPS = (
    "antecedents",
    "api",
    "commands",
    "consequents",
    "controllers",
    "device_kinds",
    "devices",
    "exports",
    "indices",
    "kernels",
    "machine_controls",
    "modules",
    "nodes",
    "policies",
    "stage_kinds",
    "stages",
    "variants",
)


@cache
def given(group: str) -> dict[str, EntryPoint]:
    """Entry points of a group by name, in alphabetical order."""
    return {hook.name: hook for hook in sorted(every(), key=lambda hook: hook.name) if hook.group == PREFIX + group}


def module(name: str, wing: str | None = None) -> ModuleType:
    """A module under this package's name that another package has. Raises `ModuleNotFoundError`.

    `wing`: name in `commands` of the package whose room of that name it is; None: its own name is in `modules`.
    """
    row = given("modules").get(name) if wing is None else given("commands").get(wing)
    if row is None:
        raise ModuleNotFoundError(f"No module named 'facts_damping.{name}'", name=f"facts_damping.{name}")
    return importlib.import_module(row.value if wing is None else f"{row.value}.{name}")


@cache
def every() -> list[EntryPoint]:
    """Entry points of all groups.

    Raises `InputError` for an unknown group, an incomplete pair, or a name that is given twice.
    """
    known = entry_points()
    hooks = [hook for group in sorted(known.groups) if group.startswith(PREFIX) for hook in known.select(group=group)]
    by_name: dict[tuple[str, str], EntryPoint] = {}
    for hook in hooks:
        group = hook.group.removeprefix(PREFIX)
        if group not in GROUPS:
            raise InputError(f"{_named(hook)}: no such group; allowed: {', '.join(PREFIX + group for group in GROUPS)}")
        other = PREFIX + NEEDS.get(group, "")
        if other != PREFIX and not any(two.group == other and two.name == hook.name for two in hooks):
            raise InputError(f"{_named(hook)}: given alone; allowed: with {hook.name} of {other}")
        first = by_name.setdefault((group, hook.name), hook)
        if first is not hook:
            raise InputError(f"{_named(hook)}: the name is taken; allowed: another than that of {_named(first)}")
    return hooks


def rows(group: str, row: type, used: Collection[str] = ()) -> dict[str, Any]:
    """Rows that packages add to a table, by name.

    `row`: required type of each row, or base class; `used`: names already taken. Raises `InputError` if a row cannot
    be loaded, has another type, or has a name that is taken.
    """
    loaded = {}
    for name, hook in given(group).items():
        if name in used:
            raise InputError(f"{_named(hook)}: the name is taken; allowed: another than {', '.join(used)}")
        try:
            loaded[name] = hook.load()
        except Exception as error:
            text = f"{_named(hook)}: {type(error).__name__}: {one_line(error)}"
            raise InputError(f"{text}; allowed: module:row, of a module that imports no table but its own") from error
        if not (isinstance(loaded[name], row) or (isinstance(loaded[name], type) and issubclass(loaded[name], row))):
            raise InputError(f"{_named(hook)}: {type(loaded[name]).__name__} given; allowed: {row.__name__}")
    return loaded


def _named(entry_point: EntryPoint) -> str:
    """Text of an entry point for messages."""
    package = entry_point.dist.name if entry_point.dist else "no package"
    return f"entry point {entry_point.name} = {entry_point.value} of {entry_point.group} ({package})"
