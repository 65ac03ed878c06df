"""What varies in every case, and its event: drawn for any grid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.grid_state import islands
from facts_damping.case.changes import off
from facts_damping.devices.base import Series

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping.parameters.plant.system import System

    Random = np.random.Generator

FAULT, TRIP, STEP, OUT = "fault", "trip", "step", "line out"
EVENTS = (TRIP, FAULT, STEP, STEP, OUT, STEP)  # in turn, of the kinds with any event
START_S = 2.0, 4.0  # of events
LARGE = 0.15  # of the scheduled generation, of an inverter that trips


class Grid(NamedTuple):
    """What cases are drawn for."""

    run: Mapping[str, Any]  # content of the run of all cases, without controllers
    rows: Mapping[str, Any]  # content of its system, before shares of machines are replaced
    system: System
    lines: Sequence[str]  # that are faulted and trip
    pmus: Sequence[str]  # of the signals
    channel: str  # of the signals


class Case(NamedTuple):
    """A case as it is drawn: fields of the run, events, and further stages of the link in both directions."""

    fields: dict[str, Any]
    start_s: float
    events: list[dict[str, Any]]
    up: list[dict[str, Any]]
    down: list[dict[str, Any]]


def number(random: Random, low: float, high: float, *, logarithmic: bool = False) -> float:
    """A random number of four digits."""
    value = float(random.uniform(low, high))
    if logarithmic:
        value = float(np.exp(random.uniform(np.log(low), np.log(high))))
    return float(f"{value:.4g}")


def scaled(value: float, factor: float) -> float:
    """A number of six digits."""
    return float(f"{value * factor:.6g}")


def meshed_lines(system: System, without: str = "") -> list[str]:
    """Lines whose trip leaves connected what was, without devices; not the line named `without`."""
    content = system.model_dump(by_alias=True)
    held = {without, *(device.line for device in system.devices if isinstance(device, Series))}
    whole = len(islands(content, frozenset()))
    return [line.name for line in system.lines if line.name not in held and len(islands(content, {line.name})) == whole]


def dispatch(grid: Grid, random: Random, loads: float, units: float) -> dict[str, float]:
    """Loads scaled together by up to 1 +- `loads`, the units with them, and each unit by up to 1 +- `units` more."""
    level, fields = number(random, 1.0 - loads, 1.0 + loads), dict[str, float]()
    for i, load in enumerate(grid.rows.get("loads", [])):
        fields |= {f"system.loads.{i}.{part}": scaled(load.get(part) or 0.0, level) for part in ("P", "Q")}
    for table in ("machines", "inverters"):
        for i, unit in enumerate(grid.rows.get(table, [])):
            if unit.get("P") is not None:
                factor = level * number(random, 1.0 - units, 1.0 + units)
                fields[f"system.{table}.{i}.P"] = scaled(unit["P"], factor)
    return fields


def noise(grid: Grid, random: Random) -> dict[str, Any]:
    """Noise of the PMUs' frequencies, Hz, that of the loads, if the run has any, and the seed of the run."""
    fields: dict[str, Any] = {"measurement.noise.frequency": number(random, 3e-4, 3e-3, logarithmic=True)}
    if not off(grid.run, "load_noise"):
        fields["load_noise.std"] = number(random, 0.005, 0.015)
    return {**fields, "seed": int(random.integers(2**31))}


def event(grid: Grid, random: Random, kind: str, start_s: float) -> list[dict[str, Any]]:
    """An event of a kind of `EVENTS`: a fault of 50 to 100 ms, a trip after it or without, or a step of 5 to 15 %."""
    line, location = str(random.choice(list(grid.lines))), number(random, 0.1, 0.9)
    end = {"time": round(start_s + number(random, 0.05, 0.1), 3), "line": line}
    if kind == STEP:
        return [_step(grid.system, random, start_s)]
    if kind == OUT:
        return [{"time": start_s, "kind": "line_out", "line": line}]
    short = {"time": start_s, "kind": "fault", "line": line, "location": location}
    return [short, {**end, "kind": "clear" if kind == FAULT else "line_out"}]


def _step(system: System, random: Random, start_s: float) -> dict[str, Any]:
    """A step of one of the larger loads, or down of a unit; an inverter as large, without a device, trips."""
    size, powers = number(random, 0.05, 0.15), [load.P for load in system.loads]
    loads = [load.name for load in system.loads if np.median(powers) <= load.P]
    acting, generated = {device.place for device in system.devices}, sum(unit.P or 0.0 for unit in system.units)
    small = [i.name for i in system.inverters if i.name not in acting and 0.0 < (i.P or 0.0) <= LARGE * generated]
    units = [*(machine.name for machine in system.machines), *small]
    if loads and (not units or random.random() < 0.5):
        change = size * float(random.choice([-1.0, 1.0]))
        return {"time": start_s, "kind": "load_step", "load": str(random.choice(loads)), "change": change}
    unit = str(random.choice(units))
    if unit in small:
        return {"time": start_s, "kind": "generator_trip", "machine": unit}
    return {"time": start_s, "kind": "mechanical_power_step", "machine": unit, "change": -size}
