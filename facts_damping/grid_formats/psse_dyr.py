"""PSS/E dynamic data files (DYR): records of machines and their controls.

A record is a bus, a model in quotes, an identifier and the model's constants, up to a `/`; it may take several lines.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError
from facts_damping.grid_formats.psse_text import as_number, read_lines
from facts_damping.parameters.validation import short

if TYPE_CHECKING:
    from pathlib import Path


class Dynamic(NamedTuple):
    """A record: the line where it begins, the machine (bus and identifier), the model and its constants."""

    line: int
    bus: int
    model: str
    machine: str
    values: tuple[float, ...]


class Dyr(NamedTuple):
    """The records of machines, and unknown records: line and beginning."""

    records: list[Dynamic]
    unread: list[tuple[int, str]]


def read_dyr(path: Path) -> Dyr:
    """The records of a DYR file. Raises `InputError` with the line of an unreadable record."""
    records, unread = list[Dynamic](), list[tuple[int, str]]()
    words, begins = list[str](), 0
    for number, line in enumerate(read_lines(path, "DYR"), 1):
        text, ended = _cut(line)
        found = re.findall(r"'[^']*'|\"[^\"]*\"|[^\s,]+", text)
        begins = begins if words else number
        words += found
        if ended and words:
            _take(words, begins, path, records, unread)
            words = []
    if words:
        raise InputError(
            f"{path}: line {begins}: {short(' '.join(words[:3]))}: not ended; allowed: a record that `/` ends"
        )
    return Dyr(records, unread)


def _cut(line: str) -> tuple[str, bool]:
    """A line up to the `/` that ends its record, and whether there is one. Comments begin with `//` or `@!`."""
    if line.lstrip().startswith(("//", "@!")):
        return "", False
    quoted = False
    for i, letter in enumerate(line):
        quoted = quoted != (letter == "'")
        if letter == "/" and not quoted:
            return line[:i], True
    return line, False


def _take(words: list[str], line: int, path: Path, records: list[Dynamic], unread: list[tuple[int, str]]) -> None:
    """Add a record to the machines' or to the unknown ones."""
    where = f"{path}: line {line}"
    if len(words) < 3 or not words[0].isdigit() or words[1][0] not in "'\"":
        unread.append((line, " ".join(words[:3])))
        return
    model = words[1].strip("'\" ").upper()
    values = tuple(as_number(text, f"{where}: {model}: value {i}") for i, text in enumerate(words[3:], 1))
    records.append(Dynamic(line, int(words[0]), model, words[2].strip("'\" "), values))
