"""PSS/E files: power flow (RAW), versions 32 to 35, and dynamic data (DYR).

A RAW file has records by section, whose columns are defined in tables here. Records are in free format: values between
commas or blanks, text in quotes, `/` ends a record, an empty value between commas is the default. PSS/E Program
Operation Manual, Power Flow Data File Contents.

A DYR file has records of machines and their controls: a bus, a model in quotes, an identifier and the model's
constants, up to a `/`; a record may take several lines.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.errors import InputError
from facts_damping.input_files import GRID, is_file, read_text
from facts_damping.parameters.field_errors import short

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

VERSIONS = (32, 33, 34, 35)

# Sections in their order. Those without columns are skipped, and reported if not empty.
_COMMON = (
    *("bus", "load", "fixed shunt", "generator", "branch", "transformer", "area", "two-terminal dc", "VSC dc"),
    *("impedance correction", "multi-terminal dc", "multi-section line", "zone", "inter-area transfer", "owner"),
    *("FACTS device", "switched shunt", "GNE device", "induction machine"),
)
_SINCE_34 = (*_COMMON[:5], "switching device", *_COMMON[5:], "substation")
SECTIONS = {32: _COMMON[:-1], 33: _COMMON, 34: ("system-wide", *_SINCE_34), 35: ("system-wide", *_SINCE_34)}
TEXT = {"NAME", "ID", "CKT"}

# Columns: name, or name=default, up to the last one needed. By the first version that has them.
_RATES = " ".join(f"RATE{i}=0" for i in range(1, 13))
COLUMNS: dict[str, dict[int, str]] = {
    "bus": {32: "I NAME= BASKV=0 IDE=1 AREA=1 ZONE=1 OWNER=1 VM=1 VA=0"},
    "load": {32: "I ID=1 STATUS=1 AREA=1 ZONE=1 PL=0 QL=0 IP=0 IQ=0 YP=0 YQ=0"},
    "fixed shunt": {32: "I ID=1 STATUS=1 GL=0 BL=0"},
    "generator": {
        32: "I ID=1 PG=0 QG=0 QT=9999 QB=-9999 VS=1 IREG=0 MBASE=0 ZR=0 ZX=1 RT=0 XT=0 GTAP=1 STAT=1 RMPCT=100 PT=9999",
        35: "I ID=1 PG=0 QG=0 QT=9999 QB=-9999 VS=1 IREG=0 NREG=0 MBASE=0 ZR=0 ZX=1 RT=0 XT=0 GTAP=1 STAT=1 RMPCT=100"
        " PT=9999",
    },
    "branch": {
        32: "I J CKT=1 R=0 X B=0 RATEA=0 RATEB=0 RATEC=0 GI=0 BI=0 GJ=0 BJ=0 ST=1",
        34: f"I J CKT=1 R=0 X B=0 NAME= {_RATES} GI=0 BI=0 GJ=0 BJ=0 ST=1",
    },
    "switched shunt": {
        32: "I MODSW=1 ADJM=0 ST=1 VSWHI=1 VSWLO=1 SWREM=0 RMPCT=100 NAME= BINIT=0",
        35: "I ID=1 MODSW=1 ADJM=0 ST=1 VSWHI=1 VSWLO=1 SWREG=0 NREG=0 RMPCT=100 NAME= BINIT=0",
    },
}
# A transformer has four lines, or five with a third bus.
TRANSFORMER = (
    "I J K=0 CKT=1 CW=1 CZ=1 CM=1 MAG1=0 MAG2=0 NMETR=2 NAME= STAT=1",
    "R1=0 X1 S1=0 R2=0 X2=0 S2=0 R3=0 X3=0 S3=0 VMSTAR=1 ANSTAR=0",
    "WINDV=1 NOMV=0 ANG=0",
    "WINDV=1 NOMV=0 ANG=0",
    "WINDV=1 NOMV=0 ANG=0",
)

Row = dict[str, Any]


class Quoted(str):
    """A value in quotes: always text, never a number or a default."""

    __slots__ = ()


class RawCase(NamedTuple):
    """A case: its base (MVA, Hz), rows by section, each with its `line`, and record counts of other sections."""

    name: str
    version: int
    base_power: float
    frequency: float
    tables: dict[str, list[Row]]
    unread: dict[str, int]


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


def read_lines(path: Path, kind: str) -> list[str]:
    """The lines of a file; `kind`: RAW or DYR."""
    if not is_file(path):
        raise InputError(f"{path}: no such file; allowed: an existing PSS/E {kind} file")
    return read_text(path, GRID, "replace").splitlines()


def as_number(text: str, where: str) -> float:
    """A finite number; its exponent may be marked by D."""
    try:
        value = float(re.sub(r"[dD]", "E", text.strip("'\"")))
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {short(text)} given; allowed: a number")
    return value


# RAW


def read_raw(path: Path) -> RawCase:
    """The records of a RAW file. Raises `InputError` with line and field of an unreadable value."""
    lines = read_lines(path, "RAW")
    where = f"{path}: line 1"
    allowed = ", ".join(map(str, VERSIONS))
    if not lines:
        raise InputError(f"{path}: empty; allowed: a PSS/E RAW file of version {allowed}")
    head = _values(lines[0], where)
    version = int(as_number(head[2] if len(head) > 2 else "", f"{where}: REV, the version"))
    if version not in VERSIONS:
        raise InputError(f"{where}: version {version} given; allowed: {allowed}")
    base = as_number(head[1], f"{where}: SBASE")
    frequency = as_number(head[5], f"{where}: BASFRQ") if len(head) > 5 and head[5] else 60.0
    if not base > 0.0 or not 10.0 <= frequency <= 400.0:
        raise InputError(f"{where}: SBASE {base:g}, BASFRQ {frequency:g} given; allowed: above 0, and 10 to 400 Hz")
    tables: dict[str, list[Row]] = {section: [] for section in (*COLUMNS, "transformer")}
    unread: dict[str, int] = {}
    numbered = _records(lines)
    for section in SECTIONS[version]:
        for number, line in numbered:
            at = f"{path}: line {number}: {section}"
            if _ends(line):
                break
            if section == "transformer":
                tables[section].append(_transformer(line, number, numbered, at))
            elif section in COLUMNS:
                columns = max(v for v in COLUMNS[section] if v <= version)
                tables[section].append(_row(COLUMNS[section][columns], line, at) | {"line": number})
            else:
                unread[section] = unread.get(section, 0) + 1
    for section in ("bus", "generator"):
        if not tables[section]:
            raise InputError(f"{path}: no {section} record given; allowed: at least one")
    unread.pop("system-wide", None)
    return RawCase(path.stem, version, base, frequency, tables, unread)


def _records(lines: list[str]) -> Iterator[tuple[int, str]]:
    """Numbered lines after the three header lines, without comments; the end of the file ends all sections."""
    for number, line in enumerate(lines[3:], 4):
        if line.startswith("@!") or not line.strip():
            continue
        if line.strip() in ("Q", "q"):
            return
        yield number, line


def _ends(line: str) -> bool:
    """Whether a line ends a section: its first value is 0."""
    return re.match(r"\s*0\s*(/|,|\s|$)", line) is not None and not re.match(r"\s*0\s*,\s*[^/\s]", line)


def _values(line: str, where: str) -> list[str]:
    fields, rest = list[str](), line
    while True:
        rest = rest.lstrip()
        if not rest or rest[0] == "/":
            return fields
        if rest[0] in "'\"":
            end = rest.find(rest[0], 1)
            if end < 0:
                raise InputError(f"{where}: {short(rest)} given; allowed: text with a closing quote")
            fields.append(Quoted(rest[1:end].strip()))
            rest = rest[end + 1 :].lstrip()
        else:
            part = re.match(r"[^,/\s'\"]*", rest)
            fields.append(part.group() if part else "")
            rest = rest[len(fields[-1]) :].lstrip()
        if rest[:1] == ",":
            rest = rest[1:]
            if not rest.strip():
                return fields


def _row(columns: str, line: str, where: str) -> Row:
    values, row = _values(line, where), Row()
    for i, column in enumerate(columns.split(" ")):
        name, has_default, default = column.partition("=")
        text = values[i] if i < len(values) else ""
        if name in TEXT:
            row[name] = text or default
        elif text == "" and has_default and not isinstance(text, Quoted):
            row[name] = float(default)
        else:
            row[name] = as_number(text, f"{where}: {name}")
    return row


def _transformer(line: str, number: int, numbered: Iterator[tuple[int, str]], where: str) -> Row:
    """The lines of a transformer as one row; columns of a winding have its number as a suffix."""
    row = _row(TRANSFORMER[0], line, where) | {"line": number}
    count = 4 if row["K"] == 0.0 else 5
    for i in range(1, count):
        following = next(numbered, None)
        if following is None:
            raise InputError(f"{where}: ends after {i} of {count} lines; allowed: all of them")
        values = _row(TRANSFORMER[i], following[1], where.replace(f"line {number}", f"line {following[0]}"))
        row |= values if i == 1 else {f"{name}{i - 1}": value for name, value in values.items()}
    return row


# DYR


def read_dyr(path: Path) -> Dyr:
    """The records of a DYR file. Raises `InputError` with the line of an unreadable record."""
    records, unread = list[Dynamic](), list[tuple[int, str]]()
    words, begins = list[str](), 0
    for number, line in enumerate(read_lines(path, "DYR"), 1):
        text, ended = _cut(line)
        begins = begins if words else number
        words += re.findall(r"'[^']*'|\"[^\"]*\"|[^\s,]+", text)
        if ended and words:
            record = _dynamic(words, begins, path)
            records += [record] if record is not None else []
            unread += [(begins, " ".join(words[:3]))] if record is None else []
            words = []
    if words:
        start = f"{path}: line {begins}: {short(' '.join(words[:3]))}"
        raise InputError(f"{start}: not ended; allowed: a record that `/` ends")
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


def _dynamic(words: list[str], line: int, path: Path) -> Dynamic | None:
    """The record of a machine; None for any other."""
    if len(words) < 3 or not words[0].isdigit() or words[1][0] not in "'\"":
        return None
    model, where = words[1].strip("'\" ").upper(), f"{path}: line {line}"
    values = tuple(as_number(text, f"{where}: {model}: value {i}") for i, text in enumerate(words[3:], 1))
    return Dynamic(line, int(words[0]), model, words[2].strip("'\" "), values)
