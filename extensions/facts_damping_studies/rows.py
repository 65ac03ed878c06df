"""Rows of tables and journals as values by column, and read again.

A row is a frozen dataclass, each of its fields a column. The fields of a part (a named tuple) and the entries of a
dictionary are columns in its place. A field of a row at its default has no column. When a row is read, the entries of a
dictionary are the columns up to those of the next field that is there.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, fields
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, get_args, get_origin, get_type_hints

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from typing_extensions import Self

WHOLE = {"whole": True}  # metadata of a field: its dictionary is a single column


@dataclass(frozen=True)
class Row:
    """A row; what it holds says the class that extends it."""

    @cached_property
    def cells(self) -> dict[str, Any]:
        """Values by column, in the order of the table."""
        return _cells(self)

    @classmethod
    def read(cls, cells: Mapping[str, Any]) -> Self:
        """The row of these values by column, in the order of the table."""
        row: Self = _read(cls, cells, list(cells))
        return row


class Column(NamedTuple):
    """A field: its name, its default, and how it becomes columns."""

    name: str
    default: Any
    part: Any  # class of a part; None: no part
    entries: bool  # a column for each entry of a dictionary
    prefix: str  # of the columns of a part

    @property
    def known(self) -> list[str]:
        """Its columns whose names are known."""
        if self.part is None:
            return [] if self.entries else [self.name]
        return [self.prefix + name for column in _columns(self.part) for name in column.known]


@cache
def _columns(kind: Any) -> list[Column]:
    """The fields of a row or a part."""
    hints = get_type_hints(kind)
    if hasattr(kind, "_fields"):
        known: dict[str, tuple[Any, Mapping[str, Any]]] = {name: (MISSING, {}) for name in kind._fields}
    else:
        known = {field.name: (field.default, field.metadata) for field in fields(kind)}
        known |= {field.name: ({}, field.metadata) for field in fields(kind) if field.default_factory is dict}
    columns = []
    for name, (default, about) in known.items():
        part = next((hint for hint in (hints[name], *get_args(hints[name])) if hasattr(hint, "_fields")), None)
        entries = get_origin(hints[name]) is dict and "whole" not in about
        columns.append(Column(name, default, part, entries, about.get("prefix", "")))
    return columns


def _cells(row: Any) -> dict[str, Any]:
    cells: dict[str, Any] = {}
    for column in _columns(row.__class__):
        value = getattr(row, column.name)
        if value == column.default:
            continue
        if column.part is not None and value is not None:
            value = {column.prefix + name: cell for name, cell in _cells(value).items()}
        cells |= value if column.entries or column.part is not None else {column.name: value}
    return cells


def _read(kind: Any, cells: Mapping[str, Any], left: list[str], after: Sequence[Column] = (), prefix: str = "") -> Any:
    """A row or part of these values; `left`: columns that no earlier field has; `after`: those of later parts."""
    columns, values = _columns(kind), dict[str, Any]()
    for i, column in enumerate(columns):
        later = [*columns[i + 1 :], *after]
        names = [prefix + name for name in column.known]
        if column.entries:
            ends = (
                left.index(other.known[0])
                for other in later
                if other.known and other.known[0] in left and _has(cells, other)
            )
            end = next(ends, len(left))
            values[column.name] = {name: cells[name] for name in left[:end]}
            del left[:end]
        elif column.part is not None and _has(cells, column):
            values[column.name] = _read(column.part, cells, left, later, column.prefix)
        elif column.part is None and names[0] in cells:
            values[column.name] = cells[names[0]]
            left[:] = [name for name in left if name != names[0]]
    return kind(**values)


def _has(cells: Mapping[str, Any], column: Column) -> bool:
    return all(name in cells for name in column.known)
