"""PSS/E files: power flow (RAW), version 23 and 32 to 35, and dynamic data (DYR).

A RAW file has a head of three lines, then records by section, which a 0 ends; `Q` ends the file, and sections at its
end may be missing. A DYR file has records of machines and their controls: a bus, a model in quotes, an identifier and
the model's constants, up to a `/`; a record may take several lines. What follows a `/`, and lines that begin with one
or with `@!`, are comments.

What cannot be read is collected as problems, so that a user is told all of them at once.
"""

from __future__ import annotations

import math
import re
from itertools import chain
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError, ProblemsError
from facts_damping.input_files import GRID, is_file, read_text
from facts_damping.parameters.field_errors import short
from facts_damping_grids.psse.records import (
    COLUMNS,
    DC_LINE,
    KEYS,
    LINES,
    SECTIONS,
    TRANSFORMER,
    VERSIONS,
    Quoted,
    Row,
    columns_of,
    number,
    row,
    values,
)
from facts_damping_grids.psse.version_23 import modern

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

THRESHOLD = 1e-4  # p.u., reactance up to which a branch without resistance is a zero-impedance line (THRSHZ)
MULTIPLE = {"transformer": TRANSFORMER, "two-terminal dc": DC_LINE}  # sections whose records have several lines
# Other names of models.
SYNONYMS = {"REGFM_A1": "REGFMA1", "REGFM_B1": "REGFMB1", "REGFMB1U": "REGFMB1", "DERAU1": "DERA1", "WTGA1": "WTARA1"}
CIRCUIT = 3  # place of a circuit among the constants of a plant control
# The version in a comment, as programs write it: `PSS/E-33.2`, `PSS(R)E 33 RAW`, `PSS(R)E 15-23 RAW`.
_WRITTEN_BY = re.compile(r"PSS\W{0,5}(?:R\W{0,3})?E\W{0,3}(?:15-)?(\d\d)\b")
_BEGINS = re.compile(r"""\s*\d+[\s,]+(['"])\s*[A-Za-z]\w*\s*\1""")  # a record of a DYR file
_RECORD = re.compile(_BEGINS.pattern + "[^/]*/")  # on one line


class RawCase(NamedTuple):
    """A case: its file, its base (MVA, Hz), rows by section, each with its `line`, and lines of others.

    `threshold`: largest reactance of a zero-impedance line, p.u.
    """

    name: str
    source: str
    version: int
    base_power: float
    frequency: float
    threshold: float
    tables: dict[str, list[Row]]
    unread: dict[str, list[int]]

    def where(self, section: str, record: Row) -> str:
        """File, line and section of a record."""
        return f"{self.source}: line {record['line']}: {section}"


class Dynamic(NamedTuple):
    """A record: the line where it begins, the machine (bus and identifier), the model and its constants.

    A constant that is no number, as some models have them, is not a number here; `unreadable` tells the first one.
    `circuit`: of the branch that a plant control monitors; it may be any text, which is 0 among the constants.
    """

    line: int
    bus: int
    model: str
    machine: str
    values: tuple[float, ...]
    unreadable: str = ""
    circuit: str = ""

    def where(self, file: str) -> str:
        """File, line and model, for a message."""
        return f"{file}: line {self.line}: {self.model}"


class Dyr(NamedTuple):
    """The records of machines, and other ones: line and beginning."""

    records: list[Dynamic]
    unread: list[tuple[int, str]]


def read_lines(path: Path, kind: str) -> list[str]:
    """The lines of a file; `kind`: RAW or DYR."""
    if not is_file(path):
        raise InputError(f"{path}: no such file; allowed: an existing PSS/E {kind} file")
    return read_text(path, GRID, "replace").replace("\r", "\n").split("\n")


# RAW


class _Head(NamedTuple):
    """The first line: version, base power (MVA), frequency (Hz)."""

    version: int
    base: float
    frequency: float


def read_raw(path: Path, problems: list[str] | None = None) -> RawCase:
    """The records of a RAW file.

    Unreadable values are added to `problems`, each with file, line, section and column; without it they are an error.
    Raises `ProblemsError`, and `InputError` for a file without version, buses or generators.
    """
    unreadable = list[str]() if problems is None else problems
    lines = [(i, line) for i, line in enumerate(read_lines(path, "RAW"), 1) if not line.lstrip().startswith("@!")]
    head = _head(lines, str(path))
    tables: dict[str, list[Row]] = {section: [] for section in (*COLUMNS, *MULTIPLE)}
    unread: dict[str, list[int]] = {}
    threshold = THRESHOLD
    numbered: Iterator[tuple[int, str]] = _numbered(lines[3:])
    for section in SECTIONS[head.version]:
        for i, line in numbered:
            at = f"{path}: line {i}: {section}"
            if _ends(line):
                break
            if section in MULTIPLE:
                record = _record(MULTIPLE[section], chain([(i, line)], numbered), at, unreadable)
                tables[section].append(record | {"line": i})
            elif section in COLUMNS:
                tables[section].append(row(columns_of(section, head.version), line, at, unreadable) | {"line": i})
            elif section == "system-wide":
                if line.lstrip()[0].isdigit():  # there is no such section
                    numbered = chain([(i, line)], numbered)
                    break
                threshold = _threshold(line, threshold)
            else:
                unread.setdefault(section, []).append(i)
    if unreadable:
        tables = {name: [r for r in rows if not _nameless(r)] for name, rows in tables.items()}
    if problems is None and unreadable:
        raise ProblemsError(unreadable)
    for section in ("bus", "generator"):
        if not tables[section] and not unreadable:
            raise InputError(f"{path}: no {section} record given; allowed: at least one")
    unread = {section: lines_of[:: LINES.get(section, 1)] for section, lines_of in unread.items()}
    if head.version == 23:
        tables = modern(tables, head.base)
    return RawCase(path.stem, str(path), head.version, head.base, head.frequency, threshold, tables, unread)


def _head(lines: list[tuple[int, str]], path: str) -> _Head:
    """The version may stand in a comment; or the first bus tells that it is 23."""
    if not any(line.strip() for _, line in lines):
        raise InputError(f"{path}: empty; allowed: a PSS/E RAW file of version {', '.join(map(str, VERSIONS))}")
    at, line = lines[0]
    problems: list[str] = []
    fields = row("IC=0 SBASE=100 REV=0 XFRRAT=0 NXFRAT=0 BASFRQ=60", line, f"{path}: line {at}", problems)
    if problems:
        raise ProblemsError(problems)
    version, written = int(fields["REV"]), _WRITTEN_BY.search(line)
    if version == 0 and written:
        version = int(written[1])
    if version == 0 and len(lines) > 3 and _is_old(lines[3][1]):
        version = 23
    if version not in VERSIONS:
        said, allowed = version or "none", ", ".join(map(str, VERSIONS))
        raise InputError(f"{path}: line {at}: REV, the version: {said} given; allowed: {allowed}")
    base, frequency = fields["SBASE"], fields["BASFRQ"] or 60.0
    if not base > 0.0 or not 10.0 <= frequency <= 400.0:
        said = f"SBASE {base:g}, BASFRQ {frequency:g} given; allowed: above 0, and 10 to 400 Hz"
        raise InputError(f"{path}: line {at}: {said}")
    return _Head(version, base, frequency)


def _is_old(line: str) -> bool:
    """Whether the record of a bus is of version 23: its name is the tenth value, not the second one."""
    fields = values(line, "", [])
    return len(fields) > 9 and isinstance(fields[9], Quoted) and not isinstance(fields[1], Quoted)


def _numbered(lines: list[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Lines with their numbers, without comments and empty ones; the end of the file ends all sections."""
    for i, line in lines:
        text = line.strip()
        if text in ("Q", "q"):
            return
        if text and text[0] != "/":
            yield i, line


def _ends(line: str) -> bool:
    """Whether a line ends a section: its first value is 0."""
    return re.match(r"\s*0\s*(/|,|\s|$)", line) is not None and not re.match(r"\s*0\s*,\s*[^/\s]", line)


def _threshold(line: str, before: float) -> float:
    """The THRSHZ that a line of the system-wide data gives, p.u.; else that from before."""
    match = re.search(r"THRSHZ\s*=\s*([^\s,/]+)", line)
    value = number(match[1]) if match else math.nan
    return before if math.isnan(value) else value


def _record(templates: tuple[str, ...], numbered: Iterator[tuple[int, str]], where: str, problems: list[str]) -> Row:
    """The lines of a record as one row; that of a transformer of two windings has a line less."""
    record: Row = {}
    for i, columns in enumerate(templates):
        if i == 4 and record["K"] == 0.0:
            break
        at, line = next(numbered, (0, None))
        if line is None:
            problems.append(f"{where}: ends after {i} of its lines; allowed: all of them")
            return {"I": math.nan}
        record |= row(columns, line, re.sub(r"line \d+", f"line {at}", where), problems)
    return record


def _nameless(record: Row) -> bool:
    """Whether a bus of a record could not be read."""
    return any(math.isnan(record[key]) for key in KEYS if key in record)


# DYR


def read_dyr(path: Path, problems: list[str] | None = None) -> Dyr:
    """The records of a DYR file; a record without `/` ends where the next one begins on a line.

    A last record that does not end, or a file without a record, is added to `problems`; without it that is an error, a
    `ProblemsError`.
    """
    ended, words, begins = list[tuple[int, list[str]]](), list[str](), 0
    for i, line in enumerate(read_lines(path, "DYR"), 1):
        rest = "" if line.lstrip().startswith(("//", "@!")) else line
        if words and _BEGINS.match(rest):
            ended.append((begins, words))
            words = []
        while rest:
            text, ends, rest = _cut(rest)
            begins = begins if words else i
            words += re.findall(r"'[^']*'|\"[^\"]*\"|[^\s,]+", text)
            if ends and words:
                ended.append((begins, words))
                words = []
    if words or not ended:
        problem = f"{path}: no record given; allowed: at least one"
        if words:
            problem = f"{path}: line {begins}: {short(' '.join(words[:3]))}: not ended; allowed: a record that `/` ends"
        if problems is None:
            raise ProblemsError([problem])
        problems.append(problem)
    read = [(line, record, _dynamic(record, line)) for line, record in ended]
    return Dyr(
        [dynamic for _, _, dynamic in read if dynamic is not None],
        [(line, " ".join(record[:3])) for line, record, dynamic in read if dynamic is None],
    )


def _cut(line: str) -> tuple[str, bool, str]:
    """A line up to the `/` that ends its record, whether there is one, and what follows: another record, or nothing."""
    end = line.find("/")
    while end >= 0:
        if line.count("'", 0, end) % 2 == 0 and line.count('"', 0, end) % 2 == 0:
            rest = line[end + 1 :]
            return line[:end], True, rest if line[:end].strip() and _RECORD.match(rest) else ""
        end = line.find("/", end + 1)
    return line, False, ""


def _dynamic(words: list[str], line: int) -> Dynamic | None:
    """The record of a machine; None for any other. One of a user's model (USRMDL) has the name of that model."""
    if len(words) < 3 or not words[0].isdigit() or not words[1].strip("'\" ")[:1].isalpha():
        return None
    model, constants = words[1].strip("'\" ").upper(), words[3:]
    if model == "USRLOD":
        return None
    if model == "USRMDL" and constants and math.isnan(number(constants[0])):
        model, constants = constants[0].strip("'\" ").upper(), constants[7:]  # behind six counts
    model, circuit = SYNONYMS.get(model, model), ""
    if model.startswith("REPC") and len(constants) > CIRCUIT:
        circuit = constants[CIRCUIT].strip("'\" ")
        constants = [*constants[:CIRCUIT], "0", *constants[CIRCUIT + 1 :]]
    numbers = tuple(number(text) for text in constants)
    bad = next((i for i, value in enumerate(numbers) if math.isnan(value)), None)
    unreadable = "" if bad is None else f"value {bad + 1}: {short(constants[bad])} given; allowed: a number"
    return Dynamic(line, int(words[0]), model, words[2].strip("'\" ") or "1", numbers, unreadable, circuit)
