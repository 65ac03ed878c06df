"""Entries of a score: what was measured of a controller in all cases of a set, as its card's file has it."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import partial
from random import SystemRandom
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.control.table import kind_of
from facts_damping.errors import FactsDampingError, InputError, one_line
from facts_damping.input_files import read_text, share_folder
from facts_damping.parameters.run import Controller
from facts_damping.simulation.loop import build_loop
from facts_damping_studies.score.cases.sets import case_of
from facts_damping_studies.score.division import division_of
from facts_damping_studies.score.files import files_of
from facts_damping_studies.score.isolation.isolated import confinement, isolated
from facts_damping_studies.score.measure import Measured, Seen, as_on_card, measure
from facts_damping_studies.score.reference import reference
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from facts_damping_studies.score.cases.sets import Controllers, Set

NONE = "no control"
FULL, FULL_LATE = "full state", "full state, delayed"  # upper references
FIXED = (NONE, FULL, FULL_LATE)  # entries that are no controllers


class Result(NamedTuple):
    """Of a controller in a case."""

    measured: Measured
    alone: Measured  # without a supervisor
    seen: Seen


@dataclass(frozen=True)
class Entry:
    """A controller, and what was measured of it in each case of a set."""

    name: str
    rows: Sequence[dict[str, Any]]  # of `controllers` of a run
    files: Mapping[str, str]  # name: content, of the files of user's programs
    cases: list[Measured]
    unsupervised: list[Measured]  # in the cases without a supervisor; where it never trips, as with it
    division: str  # what the controller knows
    confined: list[str]  # what holds users' programs apart


def measured_entries(
    case_set: Set, controllers: Mapping[str, Controllers], jobs: int, progress: Callable[[int, int], None]
) -> dict[str, Entry]:
    """Measure controllers, and those of `FIXED` that are named, in all cases.

    Raises `InputError` for a controller that cannot be built, before any run, and with the first case that cannot be
    made.
    """
    for rows in controllers.values():
        with isolated(case_of(case_set, rows, 0), case_set.controller_seed) as (case, _):
            build_loop(case)
    tasks = [(name, rows, i) for name, rows in controllers.items() for i in range(len(case_set.cases))]
    SystemRandom().shuffle(tasks)  # users' programs know the time, which in a fixed order would tell the case
    results: dict[str, dict[int, Result]] = {name: {} for name in controllers}
    progress(0, len(tasks))
    with workers(jobs) as each:
        for done, (name, i, result) in enumerate(each(partial(_one, case_set), tasks)):
            if isinstance(result, str):
                raise InputError(f"{case_set.name}, case {i} with {name}: {result}")
            results[name][i] = result
            progress(done + 1, len(tasks))
    return {
        name: _entry(case_set, name, rows, [result for _, result in sorted(results[name].items())])
        for name, rows in controllers.items()
    }


def _entry(case_set: Set, name: str, rows: Controllers, results: Sequence[Result]) -> Entry:
    """A file that a program reads in some cases only is a breach: it cannot be told which cases those will be."""
    read = [result.seen.files for result in results]
    every = frozenset[str]().union(*read)
    cases = [result.measured for result in results]
    if some := sorted(every - every.intersection(*read)):
        breach = f"it reads {', '.join(some)} in some cases only"
        cases = [measured._replace(breach=measured.breach or breach) for measured in cases]
    files = files_of(rows, sorted(every))
    programs = any(kind_of(Controller.model_validate(row)).program for row in rows)
    reads_plant = any(result.seen.plant for result in results)
    return Entry(
        name,
        list(rows),
        files,
        cases,
        [result.alone for result in results],
        division_of(case_of(case_set, rows, 0), reads_plant=reads_plant) if rows else "",
        list(confinement()) if programs else [],
    )


def _one(case_set: Set, task: tuple[str, Controllers, int]) -> tuple[str, int, Result | str]:
    name, rows, i = task
    try:
        return name, i, _measured(case_set, name, rows, i)
    except FactsDampingError as error:
        return name, i, one_line(error)


def _measured(case_set: Set, name: str, rows: Controllers, i: int) -> Result:
    """With a supervisor and, if it trips, without."""
    case, after = case_of(case_set, rows, i), case_set.content.after
    if name in (FULL, FULL_LATE):
        measured = as_on_card(reference(case, after, delayed=name == FULL_LATE))
        return Result(measured, measured, Seen())
    measured, seen = measure(case, after, case_set.controller_seed)
    if not measured.tripped:
        return Result(measured, measured, seen)
    alone, more = measure(replace(case, supervision=None), after, case_set.controller_seed)
    return Result(measured, alone, Seen(seen.files | more.files, seen.plant or more.plant))


def document(entry: Entry, case_set: Set) -> dict[str, Any]:
    """The JSON of an entry: what is needed to measure it again, and what was measured."""
    kinds = [(case.kind, case.event) for case in case_set.cases]
    return {
        "controller": entry.name,
        "set": case_set.name,
        "set_digest": case_set.digest,
        **({} if case_set.shipped else {"case_set": case_set.content.model_dump(mode="json", exclude={"controllers"})}),
        "rows": list(entry.rows),
        "files": dict(entry.files),
        "division": entry.division,
        "confined": entry.confined,
        "cases": [
            {"kind": kind, "event": event, **measured._asdict()}
            for (kind, event), measured in zip(kinds, entry.cases, strict=True)
        ],
        "cases_unsupervised": {
            str(i): alone._asdict()
            for i, (alone, measured) in enumerate(zip(entry.unsupervised, entry.cases, strict=True))
            if alone != measured
        },
    }


def entry_of(content: Mapping[str, Any], source: str) -> Entry:
    """An entry from its JSON. Raises `InputError`."""
    try:
        cases = [Measured(**{name: row[name] for name in Measured._fields}) for row in content["cases"]]
        alone = {int(i): Measured(**row) for i, row in content["cases_unsupervised"].items()}
        return Entry(
            str(content["controller"]),
            list(content["rows"]),
            dict(content["files"]),
            cases,
            [alone.get(i, measured) for i, measured in enumerate(cases)],
            str(content["division"]),
            list(content["confined"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{source}: {one_line(error)}; allowed: a card by `facts-damping score --out`") from error


def stored_entries(case_set: Set) -> dict[str, Entry]:
    """The entries among the shipped cards (`cards/`) that are of this set, by name."""
    folder = share_folder() / "cards" / case_set.name.replace(" ", "_")
    entries = {}
    for path in sorted(folder.glob("*.json")):
        content = read_card(path)
        if content.get("set_digest") == case_set.digest:
            entry = entry_of(content, str(path))
            entries[entry.name] = entry
    return entries


def read_card(path: Path) -> dict[str, Any]:
    """The content of a card's file. Raises `InputError`."""
    try:
        content = json.loads(read_text(path))
    except ValueError as error:
        raise InputError(f"{path}: unreadable JSON: {error}; allowed: a card by `facts-damping score --out`") from error
    if not isinstance(content, dict):
        raise InputError(f"{path}: no card; allowed: a card by `facts-damping score --out`")
    return content
