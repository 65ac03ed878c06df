"""The worst cases of a campaign: a search for the smallest margin of each rule, beside random draws.

A case is a point of the unit cube: each random choice of a draw takes the next coordinate (`faults.Numbers`). A search
proposes points for the rules in turn (`proposals`), and every case that is run tells the margins of all rules. Random
points are evaluated in equal number, in turn with them.
"""

from __future__ import annotations

import math
import time
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from facts_damping.errors import FactsDampingError, one_line
from facts_damping.parameters.files import new_folder
from facts_damping.studies.campaigns import campaign as study
from facts_damping.studies.campaigns import invariants
from facts_damping.studies.campaigns.faults import Numbers
from facts_damping.studies.campaigns.proposals import proposal, turns
from facts_damping.studies.sweeps import batch
from facts_damping.studies.sweeps.journal import Journal
from facts_damping.studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from facts_damping.studies.campaigns.campaign import Choice, Draw, Plan

    Rows = Sequence[dict[str, Any]]

JOURNAL = "hunt.jsonl"
HUNTED, RANDOM = "hunted", "random"
BATCH = 28  # points of a generation: four for each rule
SIZES = 6  # coordinates for the size of a fault, at least as many as any takes
CHOICES = 6  # those of a choice, beside its lists


class Found(NamedTuple):
    """What was found about a rule."""

    rule: str
    unit: str
    worst: dict[str, Any] | None  # row with the smallest margin of the hunt; None: nothing can violate the rule
    random: dict[str, Any] | None  # the same of the random draws, in the same number and time
    violated: int  # hunted cases that violate the rule
    random_violated: int
    ratio: float | None  # severity of the worst to that of the random ones; None: none of them violates


def coordinates(made: Plan) -> int:
    """Number of coordinates of a campaign's cases."""
    return CHOICES + max(len(one.choose) for one in made.campaign.base_runs.values()) + SIZES


def case_of(made: Plan, numbers: Sequence[float]) -> tuple[Choice, list[float]]:
    """What a point chooses, and its coordinates for the size of the fault."""
    source = Numbers(numbers)
    return study.choose(made, source), list(numbers[source.taken :])


def margins_of(made: Plan, drawn: Draw) -> dict[str, float | None]:
    """Run a case; its margins by rule."""
    case = study.case_of(made, drawn)
    return invariants.margins(case, batch.closed_loop(case), study.uncontrolled(made, drawn))


def evaluate(made: Plan, task: tuple[str, list[float]]) -> tuple[str, dict[str, Any]]:
    """Key and row of a point; a case that fails has a row too, with the reason in `error`."""
    key, numbers = task
    began = time.monotonic()
    row: dict[str, Any] = {"arm": key.split()[0], "numbers": numbers, "error": None, "margins": {}}
    try:
        choice, sizes = case_of(made, numbers)
        drawn = study.drawn(made, int(key.split()[1]), choice, Numbers(sizes))
        row |= study.identity(drawn) | drawn.chosen
        row["margins"] = margins_of(made, drawn)
    except FactsDampingError as error:
        row["error"] = one_line(error)
    except Exception as error:  # noqa: BLE001 (whatever a case dies of, the others go on)
        row["error"] = f"{type(error).__name__}: {one_line(error)}"
    return key, row | {"took_s": time.monotonic() - began}


def margin(row: dict[str, Any], rule: str) -> float:
    """Margin of a row; infinity if the rule cannot be violated."""
    value = row["margins"].get(rule)
    return math.inf if value is None else float(value)


def run(
    made: Plan, folder: Path, minutes: float, jobs: int, progress: Callable[[int, int], None]
) -> list[dict[str, Any]]:
    """Hunt for so many minutes, those of earlier starts included; the rows of all cases, which a journal keeps.

    Raises `InputError` if the folder belongs to another campaign. An interrupt ends the hunt, not its journal.
    """
    with workers(jobs) as each, Journal(new_folder(folder) / JOURNAL, made.fingerprint) as journal:
        rows = journal.rows
        began = time.monotonic() - max((row["at_s"] for row in rows.values()), default=0.0)
        generation = 0
        while time.monotonic() - began < 60.0 * minutes:
            tasks = generation_of(made, rows, generation)
            for key, row in each(partial(evaluate, made), [task for task in tasks if task[0] not in rows]):
                journal.append(key, {**row, "at_s": time.monotonic() - began})
                progress(min(round(time.monotonic() - began), round(60.0 * minutes)), max(1, round(60.0 * minutes)))
            generation += 1
        return list(rows.values())


def generation_of(made: Plan, rows: dict[str, dict[str, Any]], generation: int) -> list[tuple[str, list[float]]]:
    """Points of a generation with their keys, from the rows of those before it: hunted and random ones."""
    size, first = coordinates(made), generation * BATCH
    known = [rows[f"{HUNTED} {i}"] for i in range(first)]
    points = np.array([row["numbers"] for row in known]).reshape(-1, size)
    margins = np.array([[margin(row, rule) for rule in invariants.INVARIANTS] for row in known])
    margins = margins.reshape(-1, len(invariants.INVARIANTS))
    kinds = [f"{row.get('base_run')} {row.get('fault')}" for row in known]
    random = np.random.default_rng((made.campaign.seed, generation, 1))
    bests = np.minimum.accumulate(margins)[BATCH - 1 :: BATCH]
    tasks: list[tuple[str, list[float]]] = []
    for i, rule in enumerate(turns(bests, BATCH), first):
        tasks.append((f"{HUNTED} {i}", proposal(points, kinds, margins[:, rule], random).tolist()))
        tasks.append((f"{RANDOM} {i}", random.random(size).tolist()))
    return tasks


def compared(rows: Rows) -> list[Found]:
    """What was found about each rule; the two arms in the same number of cases and the same time of computing."""
    arms = [_in_order(rows, arm) for arm in (HUNTED, RANDOM)]
    many, spent = min(map(len, arms)), min(sum(row["took_s"] for row in arm) for arm in arms)
    hunted, drawn = (_within(arm[:many], spent) for arm in arms)
    return [_found(rule, hunted, drawn) for rule in invariants.INVARIANTS]


def _in_order(rows: Rows, arm: str) -> list[dict[str, Any]]:
    return sorted((row for row in rows if row["arm"] == arm), key=lambda row: row["at_s"])


def _within(rows: Rows, spent_s: float) -> list[dict[str, Any]]:
    used = np.cumsum([row["took_s"] for row in rows])
    return [row for row, until in zip(rows, used, strict=True) if until <= spent_s + 1e-9]


def _found(rule: str, hunted: Rows, drawn: Rows) -> Found:
    units = {name: one.unit for name, one in (invariants.ALONE | invariants.BESIDE).items()}
    worst, other = (min(rows, key=lambda row: margin(row, rule), default=None) for rows in (hunted, drawn))
    counts = [sum(margin(row, rule) < 0.0 for row in rows) for rows in (hunted, drawn)]
    own, beside = (math.inf if row is None else margin(row, rule) for row in (worst, other))
    ratio = own / beside if own < 0.0 and beside < 0.0 else None
    kept = [row if math.isfinite(value) else None for row, value in ((worst, own), (other, beside))]
    return Found(rule, units[rule], kept[0], kept[1], counts[0], counts[1], ratio)
