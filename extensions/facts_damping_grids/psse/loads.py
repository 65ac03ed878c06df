"""Loads and DC lines of PSS/E records as loads of a system, and how a user has their constant power converted."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, NamedTuple

from facts_damping.errors import InputError
from facts_damping.parameters.field_errors import short
from facts_damping_grids.notes import Note
from facts_damping_grids.psse.records import Row

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping_grids.psse.reading import RawCase

KINDS = ("impedance", "current", "power")
ALLOWED = f"{', '.join(KINDS)}, or percentages of them, as in 'P: 40 impedance 60 current, Q: impedance'"


class LoadModel(NamedTuple):
    """How what a load draws at the start depends on the voltage then: fractions by their names, of PL and of QL."""

    P: dict[str, float]
    Q: dict[str, float]


IMPEDANCE = LoadModel({"impedance": 1.0}, {"impedance": 1.0})


def load_model(text: str) -> LoadModel:
    """The load model of the option `--loads`, such as `P: current, Q: impedance`; what is not given is an impedance.

    Raises `InputError`.
    """
    parts: dict[str, dict[str, float]] = {}
    for part in text.split(","):
        match = re.fullmatch(r"\s*([PQ])\s*:\s*(\S.*?)\s*", part, re.IGNORECASE)
        fractions = _fractions(match[2]) if match else None
        if match is None or fractions is None or match[1].upper() in parts:
            raise InputError(f"--loads: {short(text)} given; allowed: P and Q, each {ALLOWED}")
        parts[match[1].upper()] = fractions
    return IMPEDANCE._replace(**parts)


def _fractions(text: str) -> dict[str, float] | None:
    """The fractions that a word, or percentages with words, give; None if they give none."""
    if text.lower() in KINDS:
        return {text.lower(): 1.0}
    pairs = re.findall(r"(\d+(?:\.\d*)?)\s*%?\s*([A-Za-z]+)", text)
    fractions = {kind.lower(): float(percent) / 100.0 for percent, kind in pairs}
    said = re.sub(r"[\s%]", "", text)
    whole = "".join(percent + kind for percent, kind in pairs) == said and len(fractions) == len(pairs)
    if not whole or set(fractions) - set(KINDS) or not math.isclose(sum(fractions.values()), 1.0, abs_tol=1e-9):
        return None
    return {kind: fraction for kind, fraction in fractions.items() if fraction}


def loads(
    case: RawCase, buses: Mapping[int, Row], model: LoadModel, notes: list[str | Note], problems: list[str]
) -> list[Row]:
    """Loads in service: PL and QL as the model says, beside it constant currents and impedances of 1 p.u.

    One of which P is a current and Q an impedance is one load, so that what is set for loads sets it once.
    """
    rows = list[Row]()
    used = set[str]()
    chosen = _chosen(model)
    for record in case.tables["load"]:
        n = int(record["I"])
        if n not in buses or record["STATUS"] != 1:
            continue
        stem = free_name(f"load_{n}", record["ID"], used)
        beside = 1.0 if record.get("DGENM") == 1 else 0.0  # whether there is generation beside the load
        P, Q = (record[drawn] - beside * record.get(part, 0.0) for drawn, part in (("PL", "DGENP"), ("QL", "DGENQ")))
        if not (P or Q or record["IQ"] or record["YP"]) and record["IP"] and record["YQ"]:
            row = {"name": stem, "bus": f"B{n}", "P": record["IP"], "Q": -record["YQ"]}
            rows.append(row | {"P_fractions": {"current": 1}, "at": "nominal"})
            continue
        parts = (
            ("", P, Q, chosen),
            ("_current", record["IP"], record["IQ"], _alike("current") | {"at": "nominal"}),
            ("_impedance", record["YP"], -record["YQ"], {"at": "nominal"}),
        )
        rows += [{"name": stem + end, "bus": f"B{n}", "P": p, "Q": q} | more for end, p, q, more in parts if p or q]
    if any("at" not in row for row in rows):
        notes.append(
            f"constant power of loads becomes P: {_words(model.P)}, Q: {_words(model.Q)}; --loads: something else"
        )
    return rows + dc_lines(case, buses, notes, problems)


def _chosen(model: LoadModel) -> Row:
    """The fields of a load that a model sets; an impedance needs none."""
    both = {"P_fractions": model.P, "Q_fractions": model.Q}
    return {name: fractions for name, fractions in both.items() if fractions != IMPEDANCE.P}


def _words(fractions: Mapping[str, float]) -> str:
    """Fractions as a user gives them."""
    return " ".join(kind if part == 1.0 else f"{100.0 * part:g} {kind}" for kind, part in fractions.items())


def _alike(part: str) -> Row:
    """The fields of a load of which P and Q depend on the voltage alike."""
    return {"P_fractions": {part: 1}, "Q_fractions": {part: 1}}


def free_name(stem: str, mark: str, used: set[str]) -> str:
    """A name that is not used: with an identifier if that is not the usual 1."""
    letters = re.sub(r"[^A-Za-z0-9]", "", str(mark))
    name = stem if letters in ("", "1") else f"{stem}_{letters}"
    while name in used:
        name += "x"
    used.add(name)
    return name


# DC lines


def dc_lines(case: RawCase, buses: Mapping[int, Row], notes: list[str | Note], problems: list[str]) -> list[Row]:
    """Two-terminal DC lines as what their converters draw: constant powers, without control."""
    rows = list[Row]()
    for record in case.tables["two-terminal dc"]:
        ends = [("R", int(record["IPR"])), ("I", int(record["IPI"]))]
        if record["MDC"] == 0 or any(n not in buses for _, n in ends):
            continue
        where = case.where("two-terminal dc", record)
        flow = _dc_flow(record)
        if flow is None:
            problems.append(
                f"{where}: SETVL = {record['SETVL']:g} given; allowed: a power that VSCHD and RDC can carry"
            )
            continue
        for (end, n), voltage, power in zip(ends, (flow.rectifier, flow.inverter), (1.0, -1.0), strict=True):
            P = power * voltage * flow.current
            Q = abs(P) * _reactive(record, end, voltage, buses[n])
            rows.append({"name": f"dc_{record['line']}_{n}", "bus": f"B{n}", "P": P, "Q": Q} | _alike("power"))
        alone = f"line {record['line']}: the DC line from bus {ends[0][1]} to bus {ends[1][1]} is two constant loads"
        name = f"{ends[0][1]} to {ends[1][1]}"
        common, effect = "two constant loads, without control", "its power stays, whatever voltages and frequency do"
        section = "two-terminal dc"
        notes.append(Note(f"{alone}, without its control", common, "DC lines", name, section, "replaced", effect))
    return rows


class _DcFlow(NamedTuple):
    """Voltages of the rectifier and the inverter (kV), current (kA)."""

    rectifier: float
    inverter: float
    current: float


def _dc_flow(record: Row) -> _DcFlow | None:
    """The flow of a DC line in control of its power, or of its current (MDC 2), at the scheduled voltage.

    `V_inverter + RCOMP I = VSCHD`, `V_rectifier = V_inverter + RDC I`. SETVL: MW at the rectifier, with a minus at the
    inverter; or A. None if there is no such flow.
    """
    V, R, compounding = record["VSCHD"], record["RDC"], record["RCOMP"]
    if not V > 0.0:
        return None
    if record["MDC"] == 2:
        current = abs(record["SETVL"]) / 1000.0
    else:
        slope = (R if record["SETVL"] > 0.0 else 0.0) - compounding  # of the voltage where the power is held
        root = V * V + 4.0 * slope * abs(record["SETVL"])
        if root < 0.0:
            return None
        current = 2.0 * abs(record["SETVL"]) / (V + math.sqrt(root))
    inverter = V - compounding * current
    rectifier = inverter + R * current
    return _DcFlow(rectifier, inverter, current) if min(rectifier, inverter) > 0.0 else None


def _reactive(record: Row, end: str, voltage: float, bus: Row) -> float:
    """Reactive power per active power of a converter: its power factor is V / V0.

    V0 = NB 3 sqrt(2) / pi E, with E = EBAS TR / TAP, is the voltage without delay and load, kV.
    """
    E = bus["VM"] * (record[f"EBAS{end}"] or bus["BASKV"])
    no_load = (
        record[f"NB{end}"] * 3.0 * math.sqrt(2.0) / math.pi * E * record[f"TR{end}"] / (record[f"TAP{end}"] or 1.0)
    )
    return math.tan(math.acos(min(1.0, voltage / no_load))) if no_load > 0.0 else 0.0
