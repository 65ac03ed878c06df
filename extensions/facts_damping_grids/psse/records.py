"""Records of PSS/E files in free format, and the columns of those of a RAW file, by section and version.

Values stand between commas or blanks, text may be in quotes, a `/` that is in none ends a record, and an empty value
between commas is the default. PSS/E Program Operation Manual, Power Flow Data File Contents.
"""

from __future__ import annotations

import math
import re
from functools import cache
from typing import Any, NamedTuple

from facts_damping.parameters.field_errors import short

Row = dict[str, Any]

VERSIONS = (23, 32, 33, 34, 35)

# Sections in their order. Those without columns are skipped, and reported if not empty.
_COMMON = (
    *("bus", "load", "fixed shunt", "generator", "branch", "transformer", "area", "two-terminal dc", "VSC dc"),
    *("impedance correction", "multi-terminal dc", "multi-section line", "zone", "inter-area transfer", "owner"),
    *("FACTS device", "switched shunt", "GNE device", "induction machine"),
)
_OLD = (
    *("bus", "generator", "branch", "transformer adjustment", "area", "two-terminal dc", "switched shunt"),
    *("impedance correction", "multi-terminal dc", "multi-section line", "zone", "inter-area transfer", "owner"),
    "FACTS device",
)
_SINCE_34 = ("system-wide", *_COMMON[:5], "switching device", *_COMMON[5:], "substation")
SECTIONS = {23: _OLD, 32: _COMMON[:-1], 33: _COMMON, 34: _SINCE_34, 35: _SINCE_34}
LINES = {"two-terminal dc": 3, "VSC dc": 3}  # of a record, where it is not one
TEXT = {"NAME", "ID", "CKT"}
KEYS = {"I", "J", "K", "IPR", "IPI"}  # buses

# Columns: name, or name=default, up to the last one needed. By the first version that has them.
_RATES = " ".join(f"RATE{i}=0" for i in range(1, 13))
_GENERATOR = "MBASE=0 ZR=0 ZX=1 RT=0 XT=0 GTAP=1 STAT=1 RMPCT=100 PT=9999"
COLUMNS: dict[str, dict[int, str]] = {
    "bus": {
        23: "I IDE=1 PL=0 QL=0 GL=0 BL=0 AREA=1 VM=1 VA=0 NAME= BASKV=0 ZONE=1",
        32: "I NAME= BASKV=0 IDE=1 AREA=1 ZONE=1 OWNER=1 VM=1 VA=0",
    },
    "load": {
        32: "I ID=1 STATUS=1 AREA=1 ZONE=1 PL=0 QL=0 IP=0 IQ=0 YP=0 YQ=0",
        34: "I ID=1 STATUS=1 AREA=1 ZONE=1 PL=0 QL=0 IP=0 IQ=0 YP=0 YQ=0 OWNER=1 SCALE=1 INTRPT=0"
        " DGENP=0 DGENQ=0 DGENM=0",
    },
    "fixed shunt": {32: "I ID=1 STATUS=1 GL=0 BL=0"},
    "generator": {
        23: f"I ID=1 PG=0 QG=0 QT=9999 QB=-9999 VS=1 IREG=0 {_GENERATOR}",
        35: f"I ID=1 PG=0 QG=0 QT=9999 QB=-9999 VS=1 IREG=0 NREG=0 {_GENERATOR}",
    },
    "branch": {
        23: "I J CKT=1 R=0 X B=0 RATEA=0 RATEB=0 RATEC=0 RATIO=0 ANGLE=0 GI=0 BI=0 GJ=0 BJ=0 ST=1",
        32: "I J CKT=1 R=0 X B=0 RATEA=0 RATEB=0 RATEC=0 GI=0 BI=0 GJ=0 BJ=0 ST=1",
        34: f"I J CKT=1 R=0 X B=0 NAME= {_RATES} GI=0 BI=0 GJ=0 BJ=0 ST=1",
    },
    "switching device": {34: f"I J CKT=1 X=0 {_RATES} ST=1"},
    "switched shunt": {
        23: "I MODSW=1 VSWHI=1 VSWLO=1 SWREM=0 BINIT=0",
        32: "I MODSW=1 ADJM=0 ST=1 VSWHI=1 VSWLO=1 SWREM=0 RMPCT=100 NAME= BINIT=0",
        35: "I ID=1 MODSW=1 ADJM=0 ST=1 VSWHI=1 VSWLO=1 SWREG=0 NREG=0 RMPCT=100 NAME= BINIT=0",
    },
}
# A transformer has four lines, or five with a third bus; columns of a winding have its number as a suffix.
_WINDING = "WINDV{0}=1 NOMV{0}=0 ANG{0}=0"
TRANSFORMER = (
    "I J K=0 CKT=1 CW=1 CZ=1 CM=1 MAG1=0 MAG2=0 NMETR=2 NAME= STAT=1",
    "R1=0 X1 S1=0 R2=0 X2=0 S2=0 R3=0 X3=0 S3=0 VMSTAR=1 ANSTAR=0",
    *(_WINDING.format(i) for i in (1, 2, 3)),
)
# A two-terminal DC line has three: the line, its rectifier and its inverter.
_CONVERTER = "IP{0} NB{0}=1 ANMX{0}=0 ANMN{0}=0 RC{0}=0 XC{0}=0 EBAS{0}=0 TR{0}=1 TAP{0}=1"
DC_LINE = (
    "NAME= MDC=0 RDC=0 SETVL=0 VSCHD=0 VCMOD=0 RCOMP=0",
    _CONVERTER.format("R"),
    _CONVERTER.format("I"),
)

# A quote within text, as that of O'BRIEN, is followed by no separator.
_PART = re.compile(r"""'(?:[^']|'(?![\s,/]|$))*'|"[^"]*"|[^\s,/'"][^\s,/]*|[,/'"]""")


class Quoted(str):
    """A value in quotes: always text, never a default."""

    __slots__ = ()


class Column(NamedTuple):
    """A column of a record: whether it is text or a bus, and what it is where it is not given; None: it must be."""

    name: str
    text: bool
    bus: bool
    default: str | float | None


@cache
def columns(names: str) -> tuple[Column, ...]:
    """The columns of a table above."""
    table = []
    for column in names.split():
        name, has_default, default = column.partition("=")
        usual = default if name in TEXT else float(default) if has_default else None
        table.append(Column(name, name in TEXT, name in KEYS, usual))
    return tuple(table)


def columns_of(section: str, version: int) -> str:
    """The columns of a section in a version."""
    return COLUMNS[section][max(v for v in COLUMNS[section] if v <= version)]


def values(line: str, where: str, problems: list[str]) -> list[str]:
    """The values of a line; text without a closing quote is a problem, and ends them."""
    fields, empty = list[str](), True  # so far, and whether a comma now stands for an empty value
    for part in _PART.findall(line):
        if part == ",":
            if empty:
                fields.append("")
            empty = True
            continue
        if part == "/":
            break
        if part in ("'", '"'):
            problems.append(f"{where}: {short(line[line.rfind(part) :])} given; allowed: text with a closing quote")
            break
        quoted = part[0] in "'\""
        fields.append(Quoted(part[1:-1].replace("''", "'").strip()) if quoted else part)
        empty = False
    return fields


def number(text: str) -> float:
    """A finite number, whose exponent may be marked by D; not a number for any other text."""
    try:
        value = float(text)
    except ValueError:
        try:
            value = float(re.sub(r"[dD]", "E", text.strip("'\" ")))
        except ValueError:
            return math.nan
    return value if math.isfinite(value) and "_" not in text else math.nan  # which Python has between digits


def row(names: str, line: str, where: str, problems: list[str]) -> Row:
    """The values of a line by columns; what cannot be read is a problem, and not a number here."""
    fields, read = values(line, where, problems), Row()
    for i, (name, is_text, is_bus, default) in enumerate(columns(names)):
        text = fields[i] if i < len(fields) else ""
        if is_text:
            read[name] = text or default
        elif text == "" and default is not None and type(text) is str:
            read[name] = default
        else:
            read[name] = value = number(text)
            if math.isnan(value) or (is_bus and not value.is_integer()):
                allowed = "the number of a bus" if is_bus else "a number"
                problems.append(f"{where}: {name}: {short(str(text))} given; allowed: {allowed}")
                read[name] = math.nan
    return read
