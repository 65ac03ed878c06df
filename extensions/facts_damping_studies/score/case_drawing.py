"""Cases of any grid, drawn for a comparison: loads, dispatch, noise of the PMUs, and one event each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.grid_state import islands
from facts_damping.case.loading import changed_case
from facts_damping.devices.base import Series
from facts_damping.errors import FactsDampingError, InputError, one_line
from facts_damping.simulation import loop

if TYPE_CHECKING:
    from collections.abc import Callable

    from facts_damping.parameters.plant.system import System

    Random = np.random.Generator

FAULT, TRIP, STEP = "fault", "trip", "step"
KINDS = {
    FAULT: "a fault on a line, for 50 to 100 ms",
    TRIP: "a fault on a line, for 50 to 100 ms, cleared by its trip for good",
    STEP: "a step of 5 to 15 % of a load or of a mechanical power, or the trip of an inverter as large",
}
START_S = 1.0  # of events
MOST = 0.15  # of the scheduled generation, of an inverter that trips
TRIES = 20  # draws without a power flow solution, after which a grid is refused


class CaseDraws(NamedTuple):
    """What cases are drawn from."""

    run: dict[str, Any]  # content of the run of all cases, without controllers
    system: System
    lines: list[str]  # that are faulted and trip
    seed: int


def drawn_cases(
    draws: CaseDraws, number: int, progress: Callable[[int, int], None], *, training: bool = False
) -> list[dict[str, Any]]:
    """Cases of a case set, of each kind in turn; other ones for `training`. Raises `InputError` if none can be made."""
    random, kinds, cases = np.random.default_rng([draws.seed, training]), list(KINDS), list[dict[str, Any]]()
    for i in range(number):
        progress(i, number)
        cases.append(_possible(draws, kinds[i % len(kinds)], random))
    progress(number, number)
    return cases


def _possible(draws: CaseDraws, kind: str, random: Random) -> dict[str, Any]:
    """The first case of a kind that can be built.

    Loads are scaled together by 0.97 to 1.03, the dispatch with them, and each unit by another 0.98 to 1.02.
    """
    problem = ""
    for _ in range(TRIES):
        case = _case(draws, kind, random)
        try:
            loop.build_loop(changed_case(draws.run, draws.system.name, case["set"]))
        except FactsDampingError as error:
            problem = one_line(error)
        else:
            return case
    raise InputError(f"{draws.system.name}: {TRIES} cases drawn, none can be made, the last: {problem}")


def meshed_lines(system: System, without: str = "") -> list[str]:
    """Lines whose trip leaves connected what was, without devices; not the line named `without`."""
    content = system.model_dump(by_alias=True)
    held = {without, *(device.line for device in system.devices if isinstance(device, Series))}
    whole = len(islands(content, frozenset()))
    return [line.name for line in system.lines if line.name not in held and len(islands(content, {line.name})) == whole]


def _case(draws: CaseDraws, kind: str, random: Random) -> dict[str, Any]:
    level = random.uniform(0.97, 1.03)
    fields: dict[str, Any] = {"seed": int(random.integers(2**31))}
    fields["measurement.noise.frequency"] = _rounded(float(np.exp(random.uniform(np.log(3e-4), np.log(3e-3)))))  # Hz
    for i, load in enumerate(draws.system.loads):
        fields |= {f"system.loads.{i}.{part}": _rounded(getattr(load, part) * level) for part in ("P", "Q")}
    for i, machine in enumerate(draws.system.machines):
        if machine.P is not None:
            fields[f"system.machines.{i}.P"] = _rounded(machine.P * level * random.uniform(0.98, 1.02))
    for i, inverter in enumerate(draws.system.inverters):
        if inverter.P is not None:
            fields[f"system.inverters.{i}.P"] = _rounded(inverter.P * level * random.uniform(0.98, 1.02))
    return {"kind": kind, "set": {**fields, "scenario": _events(draws, kind, random)}}


def _events(draws: CaseDraws, kind: str, random: Random) -> list[dict[str, Any]]:
    if kind == STEP:
        return [_step(draws.system, random)]
    line, location = str(random.choice(draws.lines)), _rounded(random.uniform(0.1, 0.9))
    end = {"time": round(START_S + random.uniform(0.05, 0.1), 3), "line": line}
    fault = {"time": START_S, "kind": "fault", "line": line, "location": location}
    return [fault, {**end, "kind": "clear" if kind == FAULT else "line_out"}]


def _step(system: System, random: Random) -> dict[str, Any]:
    """A step of one of the larger loads, or down of a unit; an inverter as large, without a device, trips."""
    size, powers = _rounded(random.uniform(0.05, 0.15)), [load.P for load in system.loads]
    loads = [load.name for load in system.loads if np.median(powers) <= load.P]
    acting, generated = {device.place for device in system.devices}, sum(unit.P or 0.0 for unit in system.units)
    small = [i.name for i in system.inverters if i.name not in acting and 0.0 < (i.P or 0.0) <= MOST * generated]
    units = [*(machine.name for machine in system.machines), *small]
    if loads and (not units or random.random() < 0.5):
        change = size * float(random.choice([-1.0, 1.0]))
        return {"time": START_S, "kind": "load_step", "load": str(random.choice(loads)), "change": change}
    unit = str(random.choice(units))
    if unit in small:
        return {"time": START_S, "kind": "generator_trip", "machine": unit}
    return {"time": START_S, "kind": "mechanical_power_step", "machine": unit, "change": -size}


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
