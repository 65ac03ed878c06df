"""The rule by which the cases of the study are drawn: a plant behind a weak grid, its flags and dispatch, a fault.

    S ==(two circuits)== P -(transformers)- T1 (an inverter), T2 (one or two more), G (one that forms a grid)

S is an infinite bus, a machine, or nothing: then the one at G is the only source. The short-circuit power of both
circuits at P is SCR times the rating of the grid-following inverters. All numbers of a case come from one generator, by
its number.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

if TYPE_CHECKING:
    from numpy.random import Generator

SEED = 0xC6B4  # the first digits of the commit that fixed the rule
BASE = RATING = 100.0  # MVA, of the system and of each grid-following inverter
FAULT_AT = 0.1  # s
SCR = (1.5, 10.0)
SECONDS = (0.02, 0.4)  # duration of the fault
IMPEDANCE = (0.0, 0.2)  # p.u. of the system
BOLTED = 0.3  # part of the faults that have none
SOURCES = ("infinite", "machine", "forming")
FOLLOWING = ("REGCA1", "REGCA1", "REGCB1", "REGCC1")  # REGCA1 twice as often
FORMING = ("REGFMA1", "REGFMB1")
ELECTRICAL = ("REECB1", "REECA1")
AFTER = ("nothing", "nothing", "line_out", "trip")  # what else happens when the fault is cleared
FLAGS = ("PFFLAG", "VFLAG", "QFLAG", "PQFLAG")


class Case(NamedTuple):
    """A case: its system, its events, and what tables say of it."""

    system: dict[str, Any]
    events: list[dict[str, Any]]
    source: str
    scr: float  # of the circuits to S; the source `forming` has none
    models: tuple[str, ...]
    place: str
    impedance: float  # p.u. of the system
    seconds: float
    after: str


@cache
def units() -> dict[str, Any]:
    """The constants of all models."""
    content: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("units.yaml").read_text(encoding="utf-8"))
    return content


def case(number: int, seed: int = SEED, scr: tuple[float, float] = SCR) -> Case:
    """The case of a number."""
    chance = np.random.default_rng([seed, number])
    source, count = str(chance.choice(SOURCES)), int(chance.integers(1, 4))
    ratio = float(np.exp(chance.uniform(*np.log(scr))))
    names = [f"IBR{i + 1}" for i in range(count)]
    rows = [_following(chance, name, "T1" if name == "IBR1" else "T2") for name in names]
    controls = [row for name in names for row in _controls(chance, name)]
    if source == "forming" or chance.random() < 0.3:
        rows.append(_forming(chance, slack=source == "forming"))
    system = _grid(chance, source, ratio * RATING * count / BASE, rows)
    system |= {"inverters": rows, "inverter_controls": controls}
    system["pmus"] = [{"name": "P", "bus": "P"}, *({"name": row["name"], "machine": row["name"]} for row in rows)]
    places = [bus["name"] for bus in system["buses"] if bus["name"] != "S"]
    place = str(chance.choice(places if source == "forming" else [*places, "line_1"]))
    impedance = float(chance.uniform(*IMPEDANCE)) * float(chance.random() >= BOLTED)
    seconds, angle = float(chance.uniform(*SECONDS)), float(chance.uniform(0.0, np.pi / 2))
    after, location = str(chance.choice(AFTER)), float(chance.uniform(0.05, 0.95))
    if after == "line_out" and source == "forming":
        after = "nothing"
    where = {"line": place, "location": location} if place == "line_1" else {"bus": place}
    through = {"r": impedance * float(np.cos(angle)), "x": impedance * float(np.sin(angle))}
    events = [{"time": FAULT_AT, "kind": "fault", "duration": seconds, **where, **through}]
    if after == "line_out":
        events.append({"time": FAULT_AT + seconds, "kind": "line_out", "line": "line_1"})
    if after == "trip":
        events.append({"time": FAULT_AT + seconds, "kind": "generator_trip", "machine": names[-1]})
    return Case(system, events, source, ratio, tuple(r["model"] for r in rows), place, impedance, seconds, after)


def _following(chance: Generator, name: str, bus: str) -> dict[str, Any]:
    """A grid-following inverter at any dispatch; with or without LVPL and management of its active current."""
    model = str(chance.choice(FOLLOWING))
    dispatch = {"P": float(chance.uniform(0.0, 1.0)) * RATING, "Q": float(chance.uniform(-0.3, 0.3)) * RATING}
    row = {"name": name, "bus": bus, "rating": RATING, **dispatch, "model": model, **units()["inverters"][model]}
    if model == "REGCA1":
        row["Lvplsw"] = int(chance.random() < 0.5)
        if chance.random() < 0.3:
            row |= {"Lvpnt1": 0.0, "Lvpnt0": -1.0}
    return row


def _controls(chance: Generator, name: str) -> list[dict[str, Any]]:
    """Its electrical control, and in half of the cases that of a plant, with flags as they come."""
    model = str(chance.choice(ELECTRICAL))
    electrical = {**units()["electrical"][model], **{flag: int(chance.random() < 0.5) for flag in FLAGS}}
    electrical["Kqv"] = float(chance.choice([0.0, 2.0, 5.0]))
    wants_voltage = electrical["QFLAG"] == 1 and electrical["VFLAG"] == 0
    if wants_voltage:  # which a power factor is not
        electrical["PFFLAG"] = 0
    rows = [{"inverter": name, "model": model, **electrical}]
    if chance.random() < 0.5:
        plant = {**units()["plant"]["REPCA1"]}
        plant |= {flag: int(chance.random() < 0.5) for flag in ("VCFlag", "RefFlag", "Fflag")}
        plant |= {"Qmax": 1.2, "Qmin": 0.8} if wants_voltage else {}
        rows.append({"inverter": name, "model": "REPCA1", **plant})
    return rows


def _forming(chance: Generator, *, slack: bool) -> dict[str, Any]:
    """A grid-forming inverter at G."""
    model = str(chance.choice(FORMING))
    data = {"name": "GFM", "bus": "G", "rating": 2.0 * RATING, "V": 1.0, "model": model, **units()["inverters"][model]}
    return {**data, "slack": True} if slack else {**data, "P": float(chance.uniform(0.0, 1.0)) * RATING}


def _grid(chance: Generator, source: str, power: float, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Buses, branches, a load and the source; `power`: of a short circuit over both circuits together, p.u."""
    at, x_over_r, share = sorted({row["bus"] for row in rows}), chance.uniform(3.0, 20.0), chance.uniform(0.0, 0.5)
    x = float(2.0 / power / np.hypot(1.0, 1.0 / x_over_r))
    transformer = {"from": "P", "rating": 2.0 * RATING, "x": 0.1, "r": 0.004}
    load = float(chance.uniform(0.1, 0.8)) * RATING
    if source == "forming":  # the slack's part is within its rating
        load = sum(row.get("P", 0.0) for row in rows) + float(chance.uniform(0.0, 1.5)) * RATING
    fractions = {"impedance": 1.0 - float(share), "current": float(share)}
    system: dict[str, Any] = {
        "name": "weak",
        "base_power": BASE,
        "ranges": "physical",
        "lines": [],
        "transformers": [{"name": f"transformer_{bus}", "to": bus, **transformer} for bus in at],
        "loads": [{"name": "load", "bus": "P", "P": load, "Q": 10.0, "P_fractions": fractions}],
    }
    if source != "forming":
        circuit = {"from": "S", "to": "P", "r": x / float(x_over_r), "x": x, "b": 0.02}
        system["lines"] = [{"name": f"line_{i}", **circuit} for i in (1, 2)]
    if source == "infinite":
        system["infinite_buses"] = [{"name": "grid", "bus": "S", "V": 1.0}]
    if source == "machine":
        system |= {f"{sort}s": [units()[sort]] for sort in ("machine", "exciter", "governor")}
    names = ["P", *at, *(["S"] if source != "forming" else [])]
    return {**system, "buses": [{"name": name, "nominal_voltage": 100.0} for name in names]}
