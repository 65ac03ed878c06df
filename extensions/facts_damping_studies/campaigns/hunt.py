"""The worst cases of a campaign: a search for the smallest margin of each rule, beside random draws.

A case is a point of the unit cube: each random choice of a draw takes the next coordinate (`faults.Numbers`). A search
proposes points for the rules in turn (`proposals`), and every case that is run tells the margins of all rules. Random
points are evaluated in turn with them; the arms are compared after equal time of computing (`hunt_pages`).
"""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from facts_damping.errors import FactsDampingError, one_line
from facts_damping.parameters.files import new_folder
from facts_damping.simulation import loop
from facts_damping_studies.campaigns import campaign as study
from facts_damping_studies.campaigns import invariants
from facts_damping_studies.campaigns.faults import NOTHING, Numbers
from facts_damping_studies.campaigns.hunt_rows import HUNTED, RANDOM, SHRUNK, HuntRow, ShrunkRow, read_hunt
from facts_damping_studies.campaigns.proposals import proposal, spread, turns
from facts_damping_studies.campaigns.shrink import shrunk
from facts_damping_studies.sweeps.journal import Journal
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from facts_damping_studies.campaigns.campaign import CampaignPlan, Choice, Draw


JOURNAL = "hunt.jsonl"
ARMS = (HUNTED, RANDOM)
BATCH = 28  # points of a generation: four for each rule
EXPLORED = 112  # points that fill the cube first
SIZES = 6  # coordinates for the size of a fault, at least as many as any takes
KINDS = 3  # faults of which the worst case is shrunk, for each rule
TRIES = 10  # points proposed at most for one whose case is new


class Hunt(NamedTuple):
    """A hunt: rows of all cases, the mildest forms by rule, and whether it came to its end."""

    rows: list[HuntRow]
    shrunk: dict[str, ShrunkRow]
    complete: bool


def amounts(plan: CampaignPlan) -> NDArray[np.bool_]:
    """Which coordinates are amounts: start, duration and sizes of a fault; the others choose."""
    lists = max(len(base.choose) for base in plan.campaign.base_runs.values())
    return np.array([*[False] * (lists + 2), True, True, False, False, *[True] * SIZES])


def case_of(plan: CampaignPlan, numbers: Sequence[float]) -> tuple[Choice, list[float]]:
    """What a point chooses, and its coordinates for the size of the fault."""
    source = Numbers(numbers)
    choice = study.choose(plan, source)
    sizes = Numbers(numbers[source.taken :])
    study.drawn(plan, 0, choice, sizes)
    return choice, list(sizes.values[: sizes.taken])


def margins_of(plan: CampaignPlan, drawn: Draw) -> dict[str, float | None]:
    """Run a case; its margins by rule."""
    case = study.case_of(plan, drawn)
    return invariants.margins(case, loop.run(case), study.uncontrolled(plan, drawn))


def evaluate(plan: CampaignPlan, task: tuple[str, list[float]]) -> tuple[str, HuntRow]:
    """Key and row of a point; a case that fails has a row too, with the reason in `error`."""
    key, numbers = task
    began = time.process_time()
    arm, number = key.split()
    which = HUNTED if arm == HUNTED else RANDOM
    row = HuntRow(which, int(number), numbers, None, {}, content(plan, numbers), took_s=0.0)
    try:
        source = Numbers(numbers)
        drawn = study.drawn(plan, int(number), study.choose(plan, source), source)
        identity = study.identity(drawn)
        row = replace(row, drawn=identity._replace(labels=identity.labels | drawn.chosen))
        row = replace(row, margins=margins_of(plan, drawn))
    except FactsDampingError as error:
        row = replace(row, error=one_line(error))
    except Exception as error:  # noqa: BLE001 (whatever a case dies of, the others go on)
        row = replace(row, error=f"{type(error).__name__}: {one_line(error)}")
    return key, replace(row, took_s=time.process_time() - began)


def search(plan: CampaignPlan, rule: str, cases: int) -> list[HuntRow]:
    """Rows of so many cases, one after the other, hunted for the smallest margin of a rule."""
    rows: dict[str, HuntRow] = {}
    for i in range(cases):
        key, row = evaluate(plan, points_of(plan, rows, i, 1, [rule], cases // 4)[0])
        rows[key] = row
    return list(rows.values())


def _another(plan: CampaignPlan, seen: set[str], propose: Callable[[], NDArray[np.float64]]) -> list[float]:
    """The first point proposed, of a few, whose case differs from those seen by more than its seed; notes it."""
    for _ in range(TRIES):
        numbers: list[float] = propose().tolist()
        case = content(plan, numbers)
        if case not in seen:
            break
    seen.add(case)
    return numbers


def content(plan: CampaignPlan, numbers: Sequence[float]) -> str:
    """What distinguishes a case, without its seed: many coordinates are used by some faults only."""
    try:
        choice, sizes = case_of(plan, numbers)
    except FactsDampingError as error:
        return str(error)
    return str((choice._replace(seed=None), sizes))


def mildest(plan: CampaignPlan, task: tuple[str, str, list[float]]) -> tuple[str, ShrunkRow]:
    """Key and row of the mildest form of a point that violates a rule; the task: key, rule and point."""
    key, rule, numbers = task
    asked = 0

    def margin_of(choice: Choice, sizes: list[float]) -> float:
        nonlocal asked
        asked += 1
        try:
            return margin(margins_of(plan, _drawn(plan, 0, choice, sizes)), rule)
        except Exception:  # noqa: BLE001 (a milder case that cannot be run is none)
            return math.inf

    (choice, sizes), reached = shrunk(*case_of(plan, numbers), margin_of)
    return key, ShrunkRow(SHRUNK, int(key.split()[-1]), choice._asdict(), sizes, reached, asked)


def _drawn(plan: CampaignPlan, number: int, choice: Choice, sizes: list[float]) -> Draw:
    """The draw of a choice; another stage of a fault may take more numbers, which are those of the smallest sizes."""
    return study.drawn(plan, number, choice, Numbers([*sizes, *([0.0] * SIZES)]))


def draw_of(plan: CampaignPlan, row: HuntRow | ShrunkRow) -> Draw:
    """The draw of a row."""
    if isinstance(row, ShrunkRow):
        return _drawn(plan, row.number, row.chosen, row.sizes)
    return _drawn(plan, row.number, *case_of(plan, row.numbers))


def margin(margins: Mapping[str, float | None], rule: str) -> float:
    """Margin of a rule; infinity if it cannot be violated."""
    value = margins.get(rule)
    return math.inf if value is None else float(value)


def run(
    plan: CampaignPlan,
    folder: Path,
    minutes: float,
    jobs: int,
    scheduler: str | None,
    progress: Callable[[int, int], None],
) -> Hunt:
    """Hunt for so many minutes, those of earlier starts included; a journal keeps all cases.

    An interrupt ends the hunt, and what was found is returned. Raises `InputError` if the folder belongs to another
    campaign.
    """
    whole, complete = max(1, round(60.0 * minutes)), False
    with (
        workers(jobs, scheduler) as each,
        Journal(new_folder(folder) / JOURNAL, plan.fingerprint, read_hunt) as journal,
    ):
        rows = journal.rows
        began = time.monotonic() - max((row.at_s or 0.0 for row in _cases(rows).values()), default=0.0)
        try:
            for first in itertools.count(0, BATCH):
                if time.monotonic() - began >= 60.0 * minutes:
                    break
                tasks = [task for task in points_of(plan, _cases(rows), first, BATCH) if task[0] not in rows]
                for key, row in each(partial(evaluate, plan), tasks):
                    journal.append(key, replace(row, at_s=time.monotonic() - began))
                    progress(min(round(time.monotonic() - began), whole), whole)
            worst = [task for task in violating(_cases(rows)) if task[0] not in rows]
            for key, row in each(partial(mildest, plan), worst):
                journal.append(key, row)
            complete = True
        except KeyboardInterrupt:
            pass
        mildest_of: dict[str, ShrunkRow] = {}
        for key, rule, _ in violating(_cases(rows)):
            if isinstance(mild := rows.get(key), ShrunkRow):
                mildest_of[rule] = min(mildest_of.get(rule, mild), mild, key=distance)
        return Hunt(list(_cases(rows).values()), mildest_of, complete)


def _cases(rows: Mapping[str, HuntRow | ShrunkRow]) -> dict[str, HuntRow]:
    return {key: row for key, row in rows.items() if isinstance(row, HuntRow)}


def distance(row: ShrunkRow) -> tuple[bool, int, float]:
    """How far a mildest form is from its base run: whether a part fails, how much was chosen, how long it lasts (s)."""
    choice = row.chosen
    lasts = math.inf if choice.duration is None else choice.duration
    return choice.fault != NOTHING, len(choice.chosen) + (choice.seed is not None), lasts


def violating(cases: Mapping[str, HuntRow]) -> list[tuple[str, str, list[float]]]:
    """The worst case of each of the worst faults, for each violated rule: key of its mildest form, rule, point."""
    tasks = []
    for rule in invariants.INVARIANTS:
        faults: dict[str, str] = {}
        for key in sorted(cases, key=lambda key: margin(cases[key].margins, rule)):
            if margin(cases[key].margins, rule) < 0.0 and len(faults) < KINDS:
                faults.setdefault(cases[key].drawn.fault, key)
        tasks += [(f"{SHRUNK} {rule} {key}", rule, cases[key].numbers) for key in faults.values()]
    return tasks


def points_of(
    plan: CampaignPlan,
    rows: Mapping[str, HuntRow],
    first: int,
    many: int,
    rules: Sequence[str] = tuple(invariants.INVARIANTS),
    explored: int = EXPLORED,
) -> list[tuple[str, list[float]]]:
    """So many hunted points from number `first` on, in turn with random ones, with their keys; `rows`: those before.

    The first `explored` points fill the cube.
    """
    known = [rows[f"{HUNTED} {i}"] for i in range(first)]
    kinds = [(row.drawn.base_run, row.drawn.fault) for row in known]  # empty if a case cannot be made
    seen, which, seed = {row.content for row in known}, amounts(plan), plan.campaign.seed
    points = np.array([row.numbers for row in known]).reshape(-1, len(which))
    margins = np.array([[margin(row.margins, rule) for rule in rules] for row in known]).reshape(-1, len(rules))
    random, anywhere = (np.random.default_rng((seed, first // many, arm)) for arm in (1, 2))
    hunted = spread(max(1, explored), which, np.random.default_rng(seed))[first : first + many].tolist()
    for i in turns(np.minimum.accumulate(margins)[many - 1 :: many], many)[len(hunted) :]:
        hunted.append(_another(plan, seen, partial(proposal, points, kinds, margins[:, i], which, random)))
    both = zip(hunted, anywhere.random((many, len(which))).tolist(), strict=True)
    return [(f"{arm} {i}", at) for i, pair in enumerate(both, first) for arm, at in zip(ARMS, pair, strict=True)]
