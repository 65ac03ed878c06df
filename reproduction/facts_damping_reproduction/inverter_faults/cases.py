"""The rule by which the cases of the study are drawn: a plant behind a weak grid, its flags and dispatch, a fault.

    S ==(two circuits)== P -(transformer)- T1 (inverter), T2 (one or two more), and G (grid-forming or a machine)

S is an infinite bus, a machine, or nothing: then a grid-forming inverter at G is the only source. The short-circuit
power of the circuits at P is SCR times the rating of the grid-following inverters; with a machine that of its
transient reactance comes on top. Numbers are drawn one after the other from one generator per case, by its number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping_reproduction.inverter_faults.units import ELECTRICAL, GRID_SIDE, PLANT

if TYPE_CHECKING:
    from numpy.random import Generator

SEED = 74
BASE = 100.0  # MVA
FAULT_AT = 0.1  # s
RATING = 100.0  # MVA, of each inverter
SCR = (1.5, 10.0)
SECONDS = (0.02, 0.4)  # duration of the fault
DEEPEST, SHALLOWEST = 0.0, 0.2  # p.u., impedance of the fault
SOURCES = ("infinite", "machine", "forming")
LEADING = ("REGCA1", "REGCA1", "REGCB1", "REGCC1")  # grid-following
FORMING = ("REGFMA1", "REGFMB1")
KINDS = ("REECB1", "REECA1")
AFTER = ("nothing", "nothing", "line_out", "trip")  # when the fault is cleared
FLAGS = ("PFFLAG", "VFLAG", "QFLAG", "PQFLAG")


class Case(NamedTuple):
    """A case: its system, its events, and what the table says of it."""

    system: dict[str, Any]
    events: list[dict[str, Any]]
    source: str
    scr: float  # of the circuits to S; the source `forming` has none
    models: tuple[str, ...]
    place: str
    impedance: float  # p.u. of the system
    seconds: float
    after: str


def case(number: int, seed: int = SEED, scr: tuple[float, float] = SCR, step: float = 1 / 480) -> Case:
    """The case of a number."""
    chance = np.random.default_rng([seed, number])
    source = str(chance.choice(SOURCES))
    count = int(chance.integers(1, 4))
    ratio = float(np.exp(chance.uniform(*np.log(scr))))
    names = [f"IBR{i + 1}" for i in range(count)]
    models = [str(chance.choice(LEADING)) for _ in names]
    rows = [
        _unit(chance, name, model, "T1" if i == 0 else "T2")
        for i, (name, model) in enumerate(zip(names, models, strict=True))
    ]
    controls = [row for name in names for row in _controls(chance, name)]
    formed = source == "forming" or bool(chance.random() < 0.3)
    if formed:
        models.append(str(chance.choice(FORMING)))
        rows.append(_forming(chance, models[-1], slack=source == "forming"))
        names.append("GFM")
    x_over_r = float(chance.uniform(3.0, 20.0))
    system = _grid(chance, source, ratio * RATING * count / BASE, x_over_r, {row["bus"] for row in rows})
    if source == "forming":  # the slack's part is within its rating
        system["loads"][0]["P"] = sum(row.get("P", 0.0) for row in rows) + float(chance.uniform(0.0, 1.5)) * RATING
    system |= {"inverters": rows, "inverter_controls": controls, "step": step}
    system["pmus"] = [{"name": "P", "bus": "P"}, {"name": "T1", "machine": "IBR1"}]
    places = [bus["name"] for bus in system["buses"] if bus["name"] != "S"] + (
        ["line_1"] if source != "forming" else []
    )
    place = str(chance.choice(places))
    impedance = float(chance.uniform(DEEPEST, SHALLOWEST)) * float(chance.random() < 0.7)  # three of ten are bolted
    seconds = float(chance.uniform(*SECONDS))
    angle = float(chance.uniform(0.0, np.pi / 2))
    after = str(chance.choice(AFTER))
    if after == "line_out" and source == "forming":
        after = "nothing"
    where = {"line": place, "location": float(chance.uniform(0.05, 0.95))} if place == "line_1" else {"bus": place}
    through = {"r": impedance * float(np.cos(angle)), "x": impedance * float(np.sin(angle))}
    listed = [{"time": FAULT_AT, "kind": "fault", "duration": seconds, **where, **through}]
    if after == "line_out":
        listed.append({"time": FAULT_AT + seconds, "kind": "line_out", "line": "line_1"})
    if after == "trip":
        listed.append({"time": FAULT_AT + seconds, "kind": "generator_trip", "machine": names[count - 1]})
    return Case(system, listed, source, ratio, tuple(models), place, impedance, seconds, after)


def _unit(chance: Generator, name: str, model: str, bus: str) -> dict[str, Any]:
    """A grid-following inverter at any dispatch."""
    P = float(chance.uniform(0.0, 1.0)) * RATING
    dispatch: dict[str, Any] = {"P": P, "Q": float(chance.uniform(-0.3, 0.3)) * RATING}
    data = dict(GRID_SIDE[model])
    if "Lvplsw" in data:
        data["Lvplsw"] = int(chance.random() < 0.5)
        if chance.random() < 0.3:  # without management of the active current
            data |= {"Lvpnt1": 0.0, "Lvpnt0": -1.0}
    return {"name": name, "bus": bus, "rating": RATING, **dispatch, "model": model, **data}


def _controls(chance: Generator, name: str) -> list[dict[str, Any]]:
    """Its electrical control, and that of a plant in half of the cases, with flags as they come."""
    model = str(chance.choice(KINDS))
    electrical = {**ELECTRICAL[model], **{flag: int(chance.random() < 0.5) for flag in FLAGS}}
    electrical["Kqv"] = float(chance.choice([0.0, 2.0, 5.0]))
    if electrical["QFLAG"] == 1 and electrical["VFLAG"] == 0:  # a power factor is no voltage
        electrical["PFFLAG"] = 0
    rows = [{"inverter": name, "model": model, **electrical}]
    if chance.random() < 0.5:
        plant = {**PLANT, **{flag: int(chance.random() < 0.5) for flag in ("VCFlag", "RefFlag", "Fflag")}}
        if electrical["QFLAG"] == 1 and electrical["VFLAG"] == 0:  # it wants a voltage
            plant |= {"Qmax": 1.2, "Qmin": 0.8}
        rows.append({"inverter": name, "model": "REPCA1", **plant})
    return rows


def _forming(chance: Generator, model: str, *, slack: bool) -> dict[str, Any]:
    """A grid-forming inverter at G."""
    data = {"name": "GFM", "bus": "G", "rating": 2.0 * RATING, "model": model, **GRID_SIDE[model]}
    if slack:
        return {**data, "slack": True, "V": 1.0}
    return {**data, "P": float(chance.uniform(0.0, 1.0)) * RATING, "V": 1.0}


def _grid(chance: Generator, source: str, power: float, x_over_r: float, at: set[str]) -> dict[str, Any]:
    """Buses, branches, loads and the source; `power`: of a short circuit, p.u., over both circuits together."""
    buses = ["P", *sorted(at)]
    x = 2.0 / power / float(np.hypot(1.0, 1.0 / x_over_r))
    system: dict[str, Any] = {"name": "weak", "base_power": BASE, "lines": [], "ranges": "physical"}
    if source != "forming":
        buses.append("S")
        system["lines"] = [
            {"name": f"line_{i}", "from": "S", "to": "P", "r": x / x_over_r, "x": x, "b": 0.02} for i in (1, 2)
        ]
    system["buses"] = [{"name": name, "nominal_voltage": 100.0} for name in buses]
    system["transformers"] = [
        {"name": f"transformer_{bus}", "from": "P", "to": bus, "rating": 2.0 * RATING, "x": 0.1, "r": 0.004}
        for bus in sorted(at)
    ]
    share = float(chance.uniform(0.0, 0.5))
    system["loads"] = [
        {
            **{"name": "load", "bus": "P", "P": float(chance.uniform(0.1, 0.8)) * RATING, "Q": 10.0},
            **{"P_fractions": {"impedance": 1.0 - share, "current": share}},
        }
    ]
    if source == "infinite":
        system["infinite_buses"] = [{"name": "grid", "bus": "S", "V": 1.0}]
    if source == "machine":
        system |= _machine(x_over_r)
    return system


def _machine(x_over_r: float) -> dict[str, Any]:
    """A machine with exciter and governor, many times the inverters' rating, at S."""
    reactances = {"Xd": 1.8, "Xq": 1.7, "Xd1": 0.3, "Xq1": 0.55, "Xd2": 0.25, "Xq2": 0.25, "Xl": 0.2}
    times = {"Td01": 8.0, "Tq01": 0.4, "Td02": 0.03, "Tq02": 0.05}
    data = {"name": "M", "bus": "S", "rating": 900.0, "slack": True, "V": 1.0, "H": 5.0, "Ra": 0.3 / 10.0 / x_over_r}
    exciter = {"machine": "M", "model": "SEXS", "TATB": 0.1, "TB": 10.0, "K": 100.0, "TE": 0.05}
    governor = {"machine": "M", "model": "TGOV1", "R": 0.05, "T1": 0.5, "VMAX": 1.0, "VMIN": -1.0, "T2": 1.0, "T3": 2.0}
    return {
        "machines": [{**data, **reactances, **times}],
        "exciters": [{**exciter, "EMIN": 0.0, "EMAX": 5.0}],
        "governors": [{**governor, "DT": 0.0}],
    }
