"""How often `locate` names the right source of a forced oscillation: sources that are placed at random, by seed.

    python -m facts_damping_validation.sources --out results/sources

The rule, fixed before the seeds that are reported were run: `locate` with its defaults on a record of 70 s in which the
source is on from 5 s to the end, a sine, in noise of loads and PMUs. What counts is what it names first: the source
that explains the measurements best. At a plant with a PMU of its own a result is right if all that it names is within
one bus (one branch) of the source's bus. Without it (all loads; all plants a second time, with their PMUs left out) it
is right if the one area that it names is the source's. A refusal is wrong. The same is counted for the place that gives
most energy. All is done twice: with the grid's data, and with wrong ones, fields in `DOUBTFUL` multiplied by
exp(0.1 z), z normal. Sources
are drawn with equal chances of each sort, then of each element. Their powers oscillate by 0.2 % of all load at modes,
twice that beside, four times between (at most a fifth of their own); exciters by 0.01, 0.02, 0.04 p.u. Frequencies are
in turn that of the least damped electromechanical mode, 5 % above it, and halfway (geometric mean) to the next one that
is 15 % or more away.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import stats

from facts_damping.case.changes import as_sets, change
from facts_damping.case.loading import make_case, read_run
from facts_damping.errors import InputError, one_line
from facts_damping.output.tables import table
from facts_damping.output.terminal import Progress, show
from facts_damping.output.writing import write_whole
from facts_damping.parameters import files
from facts_damping.signals import NEVER
from facts_damping.simulation import loop
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_views.analysis.causes import Cause
from facts_damping_views.analysis.cells import areas, cells, ends
from facts_damping_views.analysis.locating import locate, named, words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from facts_damping.parameters.plant.system import System
    from facts_damping.record import Record
    from facts_damping_views.analysis.cells import Cell

NOISE = {"measurement": "p_class", "load_noise": {"std": 0.01, "time_constant": 1.0}}
DEPLOYED = {"profile": "deployment"}
STABILISERS = {"system.stabilisers.*.enabled": True}
GRIDS: dict[str, dict[str, Any]] = {  # runs; a system of another name is run with NOISE
    "two_area": DEPLOYED,
    "two_area_stabilised": {**DEPLOYED, "system": "two_area"},  # all four stabilisers, not two
    "two_area_ibr": DEPLOYED,
    "nets_nyps": DEPLOYED,
    "minniwecc": NOISE,
    "wecc_240": NOISE,
}
CHANGED = {"two_area_stabilised": STABILISERS}
PLACES = ("at", "beside", "between")
STRENGTH = (1.0, 2.0, 4.0)  # of sources at, beside and between modes
POWER, MOST = 0.002, 0.2  # amplitude of powers relative to all load; its limit relative to the power of the element
VOLTAGE = 0.01  # p.u., of exciters' setpoints
START, DURATION = 5.0, 70.0  # s
LEAST = 0.01  # of all load, up to which a load is no source
FIRST = 2000  # seed, from which on results are reported; those from 1000 on were seen with another rule
ERRORS = (0.0, 0.1)  # of the data that `locate` has
DOUBTFUL = {  # fields with these errors, by table of the system
    "machines": ("H", "Td01"),
    "exciters": ("K", "KA", "KP"),
    "stabilisers": ("K", "KS"),
    "governors": ("R",),
    "lines": ("x",),
}


class Sourced(NamedTuple):
    """One result: what was forced, and what was named."""

    system: str
    seed: int
    kind: str  # machine (its governor), exciter, inverter, load
    element: str
    place: str  # of the frequency
    frequency: float  # Hz
    with_pmu: bool  # at the plant
    error: float  # of the grid's data
    named: str
    first: float  # fraction of windows
    seen: float  # Hz
    right: bool
    by_energy: bool  # right by the energy flow alone


def case_content(name: str) -> dict[str, Any]:
    """Content of a run of a system without devices and controllers."""
    content, _ = read_run({"system": name, "devices": [], "controllers": [], **GRIDS.get(name, NOISE)})
    if name in CHANGED:
        change(content, CHANGED[name], as_sets(CHANGED[name]))
    off = {"supervision": "off", "arm_at": None, "link": "ideal"}
    return {**content, **{key: value for key, value in off.items() if key in content}, "duration": DURATION}


def frequencies(system: System) -> tuple[float, float, float]:
    """Frequencies at, beside and between modes, Hz (`PLACES`)."""
    swings = [m for m in analyse(system, []).swings if 0.1 < m.frequency_hz < 2.0]
    least = min(swings, key=lambda m: m.damping_ratio).frequency_hz
    others = [m.frequency_hz for m in swings if max(m.frequency_hz / least, least / m.frequency_hz) >= 1.15]
    nearest = min(others, key=lambda f: abs(np.log(f / least)))
    return least, 1.05 * least, sqrt(least * nearest)


def elements(system: System) -> dict[str, list[str]]:
    """Names of what may be a source, by sort."""
    least = LEAST * sum(load.P for load in system.loads)
    of = {
        "machine": [m.name for m in system.machines],
        "exciter": [e.machine for e in system.exciters if getattr(e, "enabled", True)],
        "inverter": [i.name for i in system.inverters],
        "load": [x.name for x in system.loads if least < x.P],
    }
    return {kind: names for kind, names in of.items() if names}


def doubtful(system: System, error: float, draw: np.random.Generator) -> System:
    """A system with wrong data: fields in DOUBTFUL times exp(error z), z normal."""
    tables = {}
    for name, fields in DOUBTFUL.items():
        rows = []
        for row in getattr(system, name):
            factors = {field: float(np.exp(error * draw.standard_normal())) for field in fields if hasattr(row, field)}
            rows.append(row.model_copy(update={field: getattr(row, field) * x for field, x in factors.items()}))
        tables[name] = rows
    return system.model_copy(update=tables)


def results(name: str, seeds: Sequence[int], progress: Any = lambda *_: None) -> Iterator[Sourced]:
    """Results of a system, one or two of each seed and error."""
    content = case_content(name)
    system = make_case({**content, "scenario": []}, name).system
    at, of, by_area = frequencies(system), elements(system), areas(system)
    total = sum(x.P for x in system.loads)
    sizes = {m.name: m.P or m.rating for m in system.machines} | {i.name: i.rating for i in system.inverters}
    sizes |= {x.name: x.P for x in system.loads}
    buses = {unit.name: unit.bus for unit in system.units} | {x.name: x.bus for x in system.loads}
    for n, seed in enumerate(seeds):
        progress(n, len(seeds))
        draw = np.random.default_rng(seed)
        kind = list(of)[draw.integers(len(of))]
        element = of[kind][draw.integers(len(of[kind]))]
        place = seed % len(PLACES)
        event = {"time": START, "kind": "forced_oscillation", kind: element, "frequency": at[place]}
        event["amplitude"] = STRENGTH[place] * VOLTAGE
        if kind != "exciter":
            event["amplitude"] = min(MOST, STRENGTH[place] * POWER * total / sizes[element])
        record = loop.run(make_case({**content, "scenario": [event], "seed": seed}, name))
        what = name, seed, kind, element, PLACES[place], at[place]
        bus = buses[element]

        def near(where: Cell | Cause, bus: str = bus) -> bool:
            return _near(system, where, bus)

        def in_area(where: Cell | Cause, bus: str = bus) -> bool:
            return where.areas == [by_area[bus]]

        blind = record if kind == "load" else _without(record, system, bus)
        for error in ERRORS:
            known = doubtful(system, error, np.random.default_rng([seed, 1]))
            if kind != "load" and _alone(system, bus):
                yield Sourced(*what, True, error, *_named(record, known, near))
            yield Sourced(*what, False, error, *_named(blind, known, in_area))


def _named(record: Record, system: System, is_right: Any) -> tuple[str, float, float, bool, bool]:
    """What `locate` names, the fraction of windows, the frequency that it saw; whether it, and its energy, is right."""
    try:
        where = locate(record, system)
    except InputError as error:
        return f"refused: {one_line(error)}", 0.0, float("nan"), False, False
    cell = where.places[0].cell
    if not where.causes:
        return f"no model; {words(cell)}", where.places[0].first, where.frequency, False, bool(is_right(cell))
    best = where.causes[0]
    return named(best), best.first, where.frequency, bool(is_right(best)), bool(is_right(cell))


def _around(system: System, bus: str) -> set[str]:
    """A bus and those at one branch from it."""
    return {bus} | {other for pair in ends(system).values() if bus in pair for other in pair}


def _near(system: System, where: Cell | Cause, bus: str) -> bool:
    """Whether a cell or a cause is within one bus of a bus."""
    buses = where.buses if isinstance(where, Cause) else where.buses or [where.bus]
    return set(buses) <= _around(system, bus)


def _alone(system: System, bus: str) -> bool:
    """Whether PMUs tell a bus with a plant apart from all that is farther than one bus."""
    every = cells(system, [True] * len(system.pmus)).cells
    units = {unit.name for unit in system.units if unit.bus == bus}
    return all(_near(system, cell, bus) for cell in every if units & set(cell.units))


def _without(record: Record, system: System, bus: str) -> Record:
    """A record without the PMUs at the plant at a bus: at its units, and at the next bus on branches to it."""
    at, branches = system.pmu_buses(), ends(system)
    measured = record.measured_ns.copy()
    for s, pmu in enumerate(system.pmus):
        if at[pmu.name] == bus or any(bus in branches[name] for name in pmu.branches):
            measured[:, s] = NEVER
    return replace(record, measured_ns=measured)


def rates(rows: Sequence[Sourced], *by: str) -> list[tuple[str, ...]]:
    """Table rows: groups by fields, right of all, with Wilson's 95 % interval, and right by energy."""
    groups: dict[tuple[str, ...], list[Sourced]] = {}
    for row in rows:
        groups.setdefault(tuple(str(getattr(row, field)) for field in by), []).append(row)
    return [(*key, *rate(group)) for key, group in sorted(groups.items())]


def rate(rows: Sequence[Sourced]) -> tuple[str, str, str]:
    """Right of all, Wilson's 95 % interval of the fraction, and right of all by the energy flow alone."""
    right = sum(row.right for row in rows)
    low, high = stats.binomtest(right, len(rows)).proportion_ci(0.95, method="wilson")
    return f"{right} of {len(rows)}", f"{low:.2f} to {high:.2f}", f"{sum(row.by_energy for row in rows)} of {len(rows)}"


def main() -> None:
    """Run, tell and write the table."""
    parser = argparse.ArgumentParser(description="How often locate names the right source.")
    parser.add_argument("systems", nargs="*", default=list(GRIDS))
    parser.add_argument("--first", type=int, default=FIRST, help="first seed")
    parser.add_argument("--count", type=int, default=20, help="seeds of each system")
    parser.add_argument("--out", default="results/sources", help="folder for results")
    arguments = parser.parse_args()
    folder, rows = files.new_folder(Path(arguments.out)), list[Sourced]()
    for name in arguments.systems:
        with Progress(name, "runs") as progress:
            for row in results(name, range(arguments.first, arguments.first + arguments.count), progress):
                rows.append(row)
                text = [",".join(Sourced._fields), *(",".join(str(x).replace(",", ";") for x in of) for of in rows)]
                write_whole(folder / "sources.csv", "\n".join([*text, ""]))
    for more in ((), ("system",), ("kind",), ("place",)):
        by = ("error", "with_pmu", *more)
        show("\n".join([*table([*by, "right", "95 % interval", "by energy"], rates(rows, *by), len(by)), ""]))


if __name__ == "__main__":
    main()
