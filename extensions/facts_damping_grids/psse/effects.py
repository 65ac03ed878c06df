"""Notes on records of a DYR file, and what it can change that one is replaced or left out, by what it is for."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from facts_damping_grids.notes import Note

if TYPE_CHECKING:
    from facts_damping_grids.notes import Outcome
    from facts_damping_grids.psse.reading import Dynamic

SOURCE = "no control of voltage, power or frequency, no swing of its own; it keeps its current"
EFFECTS = {
    "limiter": "field current is not limited",
    "compensator": "the exciter controls the voltage at the terminals, not at the point behind the impedance",
    "stabiliser": "swings are less damped",
    "governor": "its mechanical power stays: frequency settles elsewhere",
    "exciter": "its field voltage stays: voltages sag further and swings are damped otherwise",
    "inverter": SOURCE,
    "electrical control": SOURCE,
    "plant control": "its references stay: no control of the plant's voltage, power or frequency",
    "wind turbine": "the speed of its turbine stays, and what the wind gives",
    "relay": "it trips nothing",
    "load": "the load depends on voltage as the power flow's load does",
    "other": "what it does is missing",
}
# Models of the PSS/E library by what they are for; the first that matches counts.
FAMILIES = {
    "inverter": r"REG(C|FM)|WT[1-4]|PV[GDE]|GEWT|DER_?A|GFM|GD?FORM",
    "electrical control": r"REEC",
    "plant control": r"REPC",
    "wind turbine": r"WT(GT|GA|GP|DT|AR|PT|TQ)",
    "limiter": r"MAXEX|MINEX|MNLEX|UEL|OEL|SCL",
    "compensator": r"IEEEVC|(RE)?M?COMP|CCOMP",
    "stabiliser": r"PSS|STAB|IEEEST|ST2CUT|IVOST|OSTB|PTIST|STBSVC",
    "governor": r".*GOV|IEEEG|IEESGO|.*GAST|HYG|WSIEG|WSHY|PID|WPIDHY|WEHGOV|UCBGT|URGS|H6E|TWDM|IVOGO|TURCZ",
    "exciter": r"EX|ES[ADSUT]|IEEE[TX]|AC\d|DC\d|ST\d|SCRX|SEXS|URST|REXS|BBSEX|CELIN|IVOEX|EMAC|BUDCZT|OEX",
    "relay": r"DIST|CIROS|VTG|FRQ|LOE|RELAY|SLLP|SLNOS|UVLS|UFLS|LDS|LVS|TIOCR",
    "load": r"CMLD|CLOD|IEEL|LDFR|ACMT|CIM|CMOT|CIMTR",
}
INVERTERS = ("inverter", "electrical control", "plant control", "wind turbine")  # families of records of an inverter
OF_FAMILY = {family: re.compile(pattern) for family, pattern in FAMILIES.items()}


def family(model: str) -> str:
    """What a model of the library is for, by its name; `other` if that does not say it."""
    return next((name for name, pattern in OF_FAMILY.items() if pattern.match(model)), "other")


def effect_of(model: str) -> str:
    """What it can change that a model is left out or replaced."""
    return EFFECTS[family(model)]


def of_record(record: Dynamic, machine: str, file: str, text: str, outcome: Outcome = "", effect: str = "") -> Note:
    """A note on a record of a DYR file, which belongs to a machine."""
    alone, common = f"{record.where(file)}: of {machine}: {text}", f"{file}: {record.model}: {text}"
    return Note(alone, common, "machines", machine, record.model, outcome, effect)
