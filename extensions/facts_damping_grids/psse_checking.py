"""Checks of a converted case: what no equation can be made of is refused, what is unusual is told.

The ranges of a system's fields are there to catch slips. A case of another program may have any value that equations
allow: with one out of its range, the ranges of its system are the physical ones.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.parameters.field_errors import FieldError, field_errors
from facts_damping.parameters.plant.system import System
from facts_damping_grids.notes import Note
from facts_damping_grids.problems import Problems

if TYPE_CHECKING:
    from collections.abc import Mapping

    Origins = Mapping[tuple[str, str], str]  # file, line and model by table and machine

PHYSICAL = {"ranges": "physical"}


def checked(content: dict[str, Any], origins: Origins, problems: Problems) -> tuple[dict[str, Any], list[Note]]:
    """The content with the ranges that it needs, and notes on what is unusual; `problems` gets what is impossible."""
    unusual = field_errors(System, content)
    if not unusual:
        return content, []
    physical = content | PHYSICAL
    impossible = field_errors(System, physical)
    problems.add(*(_text(error, content, origins) for error in impossible))
    refused = {error.field for error in impossible}
    return physical, [_note(error, content, origins) for error in unusual if error.field not in refused]


def system_of(content: dict[str, Any]) -> System:
    """The system of a content in physical ranges. Raises `ProblemsError` with all that is impossible."""
    problems = Problems()
    problems.add(*(_text(error, content, {}) for error in field_errors(System, content | PHYSICAL)))
    problems.check()
    return System.model_validate(content | PHYSICAL)


def _row(error: FieldError, content: Mapping[str, Any]) -> tuple[str, str, str]:
    """Table, name of the row (the machine of a control) and field of an error; the last two are empty for others."""
    table, *place = error.field.split(".")
    if len(place) < 1 or not place[0].isdigit():
        return error.field, "", ""
    row = content[table][int(place[0])]
    return table, str(row.get("name", row.get("machine"))), ".".join(place[1:])


def _text(error: FieldError, content: Mapping[str, Any], origins: Origins) -> str:
    """An error with where its row comes from."""
    table, name, field = _row(error, content)
    where = origins.get((table, name), ": ".join(part for part in (table, name) if part))
    return ": ".join(part for part in (where, field, error.text) if part)


def _note(error: FieldError, content: Mapping[str, Any], origins: Origins) -> Note:
    """A note on a value that is out of its usual range."""
    table, name, field = _row(error, content)
    value, _, usual = error.text.partition(" given; allowed: ")
    of_record = origins.get((table, name), f"{table}: {name}")
    file, _, record = of_record.partition(": line ")
    source = f"{file}: {record.split(': ')[1]}" if record else table
    what = f"{field} is unusual; usual: {usual}" if usual else error.text
    alone = f"{of_record}: {field} {value} is unusual; usual: {usual}" if usual else f"{of_record}: {error.text}"
    return Note(alone, f"{source}: {what}", table, name)
