"""Checks of a converted case: what no equation can be made of is refused, what is unusual is told.

The ranges of a system's fields are there to catch slips. A case of another program may have any value that equations
allow: with one out of its range, the ranges of its system are the physical ones.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from facts_damping.parameters.field_errors import FieldError, field_errors
from facts_damping.parameters.plant.system import System
from facts_damping_grids.control_limits import control_key
from facts_damping_grids.notes import Note

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping_grids.problems import Problems

    Origins = Mapping[tuple[str, str], str]  # file, line and model by table and machine

OF_GENERATOR = ("rating", "P", "Q", "V", "angle", "Ra")  # fields of a machine from its record in the RAW file
PHYSICAL = {"ranges": "physical"}
LIMITS = {
    "greater than": "more than",
    "greater than or equal to": "at least",
    "less than": "less than",
    "less than or equal to": "at most",
}


def checked(content: dict[str, Any], origins: Origins, problems: Problems) -> tuple[dict[str, Any], list[Note]]:
    """The content with the ranges that it needs, and notes on what is unusual; `problems` gets what is impossible."""
    unusual = field_errors(System, content)
    if not unusual:
        return content, []
    head = ("name", "description")
    physical = {key: content[key] for key in head} | PHYSICAL | content
    refused = check_possible(physical, origins, problems)
    return physical, [_note(error, content, origins) for error in unusual if error.field not in refused]


def check_possible(content: Mapping[str, Any], origins: Origins, problems: Problems) -> set[str]:
    """Add what no equation can be made of to `problems`; the fields. The ranges of the content are physical."""
    impossible = field_errors(System, content)
    problems.add(*(_text(error, content, origins) for error in impossible))
    return {error.field for error in impossible}


def _place(error: FieldError, content: Mapping[str, Any]) -> tuple[str, str, str]:
    """Table, key of the row (the machine of a control) and field of an error; the last two are empty for others."""
    match = re.fullmatch(r"(\w+)\.(\d+)\.?(.*)", error.field)
    if match is None:
        return error.field, "", ""
    row = content[match[1]][int(match[2])]
    return match[1], control_key(row), match[3]


def _where(table: str, name: str, field: str, origins: Origins) -> str:
    """Where a row comes from: file, line and model, if they are known, else its table and name."""
    table = "generator" if table in ("machines", "inverters") and field in OF_GENERATOR else table
    return origins.get((table, name), ": ".join(part for part in (table, name) if part))


def _text(error: FieldError, content: Mapping[str, Any], origins: Origins) -> str:
    """An error with where its row comes from."""
    table, name, field = _place(error, content)
    return ": ".join(part for part in (_where(table, name, field, origins), field, error.text) if part)


def _note(error: FieldError, content: Mapping[str, Any], origins: Origins) -> Note:
    """A note on a value that is out of its usual range, or on values that are unusual beside each other."""
    table, name, field = _place(error, content)
    where = _where(table, name, field, origins)
    file, _, record = where.partition(": line ")
    source = f"{file}: {record.split(': ')[1]}" if record else table
    value_text, _, allowed = error.text.partition(" given; allowed: ")
    if not allowed:
        return Note(f"{where}: unusual: {value_text}", f"{source}: unusual: {value_text}", table, name)
    words, unit = re.fullmatch(r"(.*?)(?:, in (.*))?", allowed).groups("")  # type: ignore[union-attr]
    limit, _, value = words.rpartition(" ")
    usual = f"is unusual; usual: {LIMITS.get(limit, limit)} {value} {unit}".rstrip()
    return Note(f"{where}: {field} = {value_text} {usual}", f"{source}: {field} {usual}", table, name)
