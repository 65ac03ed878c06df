"""Parameters of compared controllers: the same search and budget for each, on training cases of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from facts_damping.case.links import mean_delays
from facts_damping.control.table import kind
from facts_damping.errors import InputError
from facts_damping.parameters.run import Controller
from facts_damping_studies.design import lead_lag
from facts_damping_studies.search import tune
from facts_damping_studies.search.space import space_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.case.model import Case
    from facts_damping_studies.design.design import Tell
    from facts_damping_studies.score.cases.own_grid import Ground
    from facts_damping_studies.score.cases.sets import Controllers

LEAST, POPULATION, SEED = 5, 10, 1  # points of a generation, and seed of the search
DAMPING = 0.05  # damping ratio that the lead-lag adds from which a search starts
UNTUNED = ("linear", "fmu", "external", "command")  # fields of controllers without parameters to choose


def tuned(
    ground: Ground, training: list[Case], controllers: Mapping[str, Controllers], budget: int, jobs: int, tell: Tell
) -> dict[str, list[dict[str, Any]]]:
    """The controllers; those with parameters to choose have them from a search of `budget` runs.

    The objective is the mean over the training cases of that of `tune`, relative to no control. A controller is tuned
    if it is alone, if none of its parameters is given, and if its kind or class has ranges (`space_of`).
    """
    ports = {"devices": ground.case_set.content.devices, "signals": ground.case_set.content.signals}
    entrants = {name: [{**ports, **row} for row in rows] for name, rows in controllers.items()}
    searched = [name for name, rows in entrants.items() if budget and len(rows) == 1 and _is_open(rows[0])]
    if not searched:
        return entrants
    if budget < LEAST * len(training):
        raise InputError(f"--budget {budget} given; allowed: 0, or {LEAST * len(training)} and more")
    weights = [1.0 / tune.uncontrolled(case) / len(training) for case in training]
    population, mode_hz = min(POPULATION, budget // len(training)), ground.mode.frequency_hz
    searches = []
    for name in searched:
        (row,) = entrants[name]
        start = _start(ground, training[0], row)
        searches.append(tune.Job(training, row, budget, SEED, population, weights, mode_hz, start))
    results = tune.in_parallel(tune.best, searches, jobs, tell("compare", "runs to tune"))
    for name, (parameters, _) in zip(searched, results, strict=True):
        entrants[name][0]["parameters"] = parameters
    return entrants


def _is_open(row: Mapping[str, Any]) -> bool:
    chosen = row.get("parameters") or any(row.get(field) for field in UNTUNED)
    return not chosen and bool(space_of(row).ranges)


def _start(ground: Ground, case: Case, row: Mapping[str, Any]) -> dict[str, float]:
    """Parameters of a lead-lag that compensates phase and delay at the mode; empty for other kinds."""
    if row.get("policy") or "T1" not in kind(row["name"]).parameters:
        return {}
    eigenvalue = ground.mode.eigenvalue
    controller = Controller(name=row["name"], devices=row["devices"], signals=row["signals"])
    delay = mean_delays(controller, case.system, case.link)[0] + case.filter.delay / case.run.frame_rate
    law = lead_lag.lead_lag(ground.residue, eigenvalue, delay, case.run.frame_rate)
    return law.parameters(DAMPING * abs(eigenvalue) / abs(ground.residue * law.response(eigenvalue)))
