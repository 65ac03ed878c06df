"""Scenarios of a grid for which a controller is designed, each with its linear plant.

- intact: the grid as it is.
- outages: each line whose loss keeps the grid together; those stay that move the modes most. The eigenvalues are
  estimated by w A v, with A of the grid right after the outage, w and v of the intact grid. Those that stay have a
  power flow of their own. Of lines that move the modes alike, as those in series or parallel do, one stays.
- drifts: loads scaled together by up to LOADS, units with them, and each unit by up to UNITS more, as drawn.

A lost signal or device changes no plant: the controller goes on without it.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import FactsDampingError
from facts_damping.parameters.events import LineSwitch
from facts_damping.plant.build import build
from facts_damping.small_signal.linearisation import state_matrix
from facts_damping_studies.robust.modal_plants import ModalPlant, Vectors, in_band, modal_plant, shifted, vectors
from facts_damping_studies.robust.plants import ReducedPlant, reduced
from facts_damping_studies.score.cases.drawing import meshed_lines
from facts_damping_studies.score.reference import in_interval
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case
    from facts_damping.parameters.events import Event
    from facts_damping.parameters.plant.system import System

    Tell = Callable[[str, str], Callable[[int, int], None]]

INTACT = "intact"
LOADS, UNITS = 0.08, 0.15  # of a drift
DRAWS = 20  # power flows tried for a drift
SWINGING = 0.3  # largest damping ratio of modes by which outages are compared
AT_ONCE = 50  # outages in one timeline
ALIKE = 5  # digits of distances of outages that are alike


class Scenario(NamedTuple):
    """A state of the grid; `line`: that is out, if any."""

    name: str
    line: str | None
    system: System
    modal: ModalPlant
    plant: ReducedPlant

    def of_signals(self, rows: Sequence[int]) -> Scenario:
        """The scenario with some of the signals."""
        chosen, plant = list(rows), self.plant
        fewer = plant._replace(C=plant.C[chosen], D=plant.D[chosen])
        return self._replace(modal=self.modal.of_signals(chosen), plant=fewer)


class Scenarios(NamedTuple):
    """All scenarios of a design, the intact grid first, and what has no place among them."""

    all: list[Scenario]
    outages: int  # lines whose outage keeps the grid together
    impossible: list[str]  # scenarios without a power flow

    def of_signals(self, rows: Sequence[int]) -> Scenarios:
        """The scenarios with some of the signals."""
        return self._replace(all=[scenario.of_signals(rows) for scenario in self.all])


class _Task(NamedTuple):
    case: Case
    signals: Sequence[str]
    name: str
    system: System
    line: str | None = None


def scenarios(case: Case, signals: Sequence[str], outages: int, drifts: int, jobs: int, tell: Tell) -> Scenarios:
    """The intact grid, the worst `outages` and some drawn `drifts` of a case, as its devices and the signals see it."""
    lines = meshed_lines(case.system) if outages else []
    intact = build(case.system, case.run.devices, [], sparse=True)
    near = vectors(state_matrix(intact)[0])
    out = worst(case, lines, near, tell("design", "outages"))[:outages]
    named: list[tuple[str, System, str | None]] = [(INTACT, case.system, None)]
    named += [(f"without {line}", without(case.system, line), line) for line in out]
    named += [(f"drift {i + 1}", system, None) for i, system in enumerate(_drifts(case, drifts))]
    chosen = [_Task(case, signals, name, system, line) for name, system, line in named]
    examined: list[Scenario | str] = run_all(_examined, chosen, jobs, tell("design", "scenarios"))
    possible = [result for result in examined if isinstance(result, Scenario)]
    return Scenarios(possible, len(lines), [name for name in examined if isinstance(name, str)])


def worst(case: Case, lines: Sequence[str], near: Vectors, progress: Callable[[int, int], None]) -> list[str]:
    """Lines sorted by how far their outages move the modes, a sum of relative distances, the farthest first."""
    intact = build(case.system, case.run.devices, [], sparse=True)
    values, left, right = swinging(near)
    moved: dict[float, str] = {}
    for first in range(0, len(lines), AT_ONCE):
        part = lines[first : first + AT_ONCE]
        whole = build(case.system, case.run.devices, _one_by_one(part), sparse=True)
        for i, line in enumerate(part):
            progress(first + i, len(lines))
            matrix, _ = state_matrix(in_interval(whole, 2 * i + 1, intact))
            distance = np.abs(shifted(matrix, right, left) - values) / np.abs(values)
            moved.setdefault(round(float(distance.sum()), ALIKE), line)
    progress(len(lines), len(lines))
    return [moved[distance] for distance in sorted(moved, reverse=True)]


def _one_by_one(lines: Sequence[str]) -> list[Event]:
    """Events by which one line after the other is out."""
    out = [LineSwitch(time=2.0 * i + 1.0, kind="line_out", line=line) for i, line in enumerate(lines)]
    back = [LineSwitch(time=2.0 * i + 2.0, kind="line_in", line=line) for i, line in enumerate(lines)]
    return [*out, *back]


def without(system: System, line: str) -> System:
    """The system without a line, and its PMUs without the line's current."""
    pmus = [
        pmu.model_copy(update={"branches": [name for name in pmu.branches if name != line]})
        if line in pmu.branches and len(pmu.branches) > 1
        else pmu
        for pmu in system.pmus
    ]
    return system.model_copy(update={"lines": [row for row in system.lines if row.name != line], "pmus": pmus})


def swinging(of: Vectors) -> Vectors:
    """The vectors of modes in the band that are little damped."""
    chosen = in_band(of.values) & (-of.values.real < SWINGING * np.abs(of.values))
    return Vectors(of.values[chosen], of.left[:, chosen], of.right[:, chosen])


def _drifts(case: Case, drifts: int) -> list[System]:
    random = np.random.default_rng([case.run.seed, drifts])
    systems: list[System] = []
    for _ in range(DRAWS * drifts):
        if len(systems) == drifts:
            break
        system = drifted(case.system, random)
        with suppress(FactsDampingError):
            build(system, case.run.devices, [], sparse=True)
            systems.append(system)
    return systems


def drifted(system: System, random: np.random.Generator) -> System:
    """The system with loads and dispatch drawn."""
    level = 1.0 + random.uniform(-LOADS, LOADS)
    loads = [load.model_copy(update={"P": load.P * level, "Q": load.Q * level}) for load in system.loads]
    units = {}
    for table in ("machines", "inverters"):
        units[table] = [
            unit
            if unit.P is None
            else unit.model_copy(update={"P": unit.P * level * (1 + random.uniform(-UNITS, UNITS))})
            for unit in getattr(system, table)
        ]
    return system.model_copy(update={"loads": loads, **units})


def _examined(task: _Task) -> Scenario | str:
    try:
        built = build(task.system, task.case.run.devices, [], sparse=True)
        modal = modal_plant(replace(task.case, system=task.system), built, task.signals)
    except FactsDampingError:
        return task.name
    limits = np.array([task.system.device(name).setpoint_max for name in task.case.run.devices])
    return Scenario(task.name, task.line, task.system, modal, reduced(modal, limits))
