"""Runs beside LLC-tuned over the ensembles of the scenarios that are judged: what a search has not seen."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.analysis.indices import INDICES
from facts_damping.configuration import load_case
from facts_damping.errors import InputError
from facts_damping.studies import sweep
from facts_damping.studies.batch import Base, Task, one_run
from facts_damping.studies.compare import scenarios
from facts_damping.studies.pages import heads, line
from facts_damping.studies.pool import run_all
from facts_damping.studies.scoring import REFERENCE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray


class Judged(NamedTuple):
    """A run over the ensemble of a scenario, beside LLC-tuned on the same draws."""

    scenario: str
    run: str
    medians: dict[str, float]  # of an index; draws that lose synchronism count as infinite
    ratios: dict[str, float]  # of the medians, over those of LLC-tuned
    better: float  # share of draws in which all four indices are below those of LLC-tuned
    undamped: int  # draws, those that lose synchronism among them
    lost: int


def judged(
    names: Sequence[str], number: int, jobs: int, progress: Callable[[int, int], None], link: str | None = None
) -> list[Judged]:
    """LLC-tuned as shipped, then runs of one system, over the first draws of every ensemble `ensemble_<system>_*`.

    A run gives controllers, devices and the link, which has to be the same in all; `link`: instead of it.
    """
    cases = [load_case(name) for name in names]
    systems, links = {case.system.name for case in cases}, {str(case.run.link) for case in cases}
    if len(systems) != 1 or len(links if link is None else {link}) != 1:
        raise InputError(f"runs: {', '.join(names)} given; allowed: runs of one system with one link")
    system, over = systems.pop(), link or links.pop()
    reference: dict[str, Any] = {"devices": ["sssc"], "controllers": [{"name": REFERENCE}]}
    sets = [reference] + [
        {"devices": case.run.devices, "controllers": [c.model_dump(exclude_unset=True) for c in case.run.controllers]}
        for case in cases
    ]
    places = [(scenario, i) for scenario in scenarios(system) for i in range(len(sets))]
    todo, counts = [], []
    for scenario, i in places:
        made = sweep.plan(f"ensemble_{system}_{scenario}", [])
        base = made.base._replace(set={**made.base.set, "link": over, **sets[i]})
        own = [(base, Task(str(n), point.changes, point.columns)) for n, point in enumerate(made.points[:number])]
        todo += own
        counts.append(len(own))
    rows = [row for _, row in run_all(_one, todo, jobs, progress)]
    parts = [rows[sum(counts[:n]) : sum(counts[: n + 1])] for n in range(len(counts))]
    found, first = [], parts[0]
    for (scenario, i), own_rows in zip(places, parts, strict=True):
        first = own_rows if i == 0 else first
        found.append(_beside(scenario, [REFERENCE, *names][i], own_rows, first))
    return found


def _one(what: tuple[Base, Task]) -> tuple[str, dict[str, Any]]:
    return one_run(*what)


def _values(rows: Sequence[dict[str, Any]]) -> NDArray[np.float64]:
    """(draws, indices). Raises `InputError` where a run could not be made."""
    for row in rows:
        if row["error"]:
            raise InputError(f"{row['controller']}, {row['scenario']}: {row['error']}")
    return np.array([[row[name] if row["stable"] else np.inf for name in INDICES] for row in rows], np.float64)


def _beside(scenario: str, name: str, rows: Sequence[dict[str, Any]], reference: Sequence[dict[str, Any]]) -> Judged:
    own, first = _values(rows), _values(reference)
    medians, others = np.median(own, axis=0), np.median(first, axis=0)
    named = partial(zip, INDICES, strict=True)
    return Judged(
        scenario,
        name,
        {key: float(value) for key, value in named(medians)},
        {key: float(value) for key, value in named(medians / others)},
        float(np.mean((own < first).all(axis=1))),
        sum(not row["damped"] for row in rows),
        sum(not row["stable"] for row in rows),
    )


def text(found: Sequence[Judged]) -> list[str]:
    """A table in Markdown: medians, and in percent how far they are from those of LLC-tuned."""
    lines = heads(["scenario", "run"], [*INDICES, "all four better", "undamped", "lost"])
    for one in found:
        cells = [f"{one.medians[key]:.4g} ({100 * (one.ratios[key] - 1):+.1f} %)" for key in INDICES]
        lines.append(
            line([one.scenario, one.run, *cells, f"{100 * one.better:.0f} %", str(one.undamped), str(one.lost)])
        )
    return lines
