"""Execution of a study: all points of its axes and the requested margins; finished runs are not repeated."""

from __future__ import annotations

import hashlib
import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.case.loading import read_run
from facts_damping.control.table import PROGRAMS
from facts_damping.errors import InputError, check_known
from facts_damping.input_files import FMU, read_bytes, read_text
from facts_damping.output.terminal import note
from facts_damping.output.writing import write_whole
from facts_damping.parameters import files
from facts_damping.parameters.field_errors import check
from facts_damping.parameters.files import check_kind, find, read_sets, read_table
from facts_damping.simulation.programs import user_code
from facts_damping.version import __version__
from facts_damping_studies.margins import margins
from facts_damping_studies.margins.criteria import CriterionFigures, fails
from facts_damping_studies.parameters import Study
from facts_damping_studies.sweeps import axes, feasibility, true_jacobian
from facts_damping_studies.sweeps.batch import Base, RunRequest, make, one_run
from facts_damping_studies.sweeps.control_outcomes import tripped
from facts_damping_studies.sweeps.enumerated_axes import expand_axis
from facts_damping_studies.sweeps.journal import Journal
from facts_damping_studies.sweeps.pool import workers
from facts_damping_studies.sweeps.sweep_rows import IDENTITY, FractionRow, MarginRow, SweepRow, figure_names

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from facts_damping.case.model import Case
    from facts_damping.output.terminal import Progress
    from facts_damping_studies.parameters import Margin
    from facts_damping_studies.sweeps.axes import Point
    from facts_damping_studies.sweeps.pool import Each

JOURNAL = "rows.jsonl"
COPY = "study.yaml"
NETWORK = ("system", "scenario", "devices")  # fields of a run that determine its plant
# Rows of a point by the value of the margin's field; None: without a margin.
PointState = dict[float | None, SweepRow]
ALWAYS = ("unstable", "not_damped")  # criteria whose failed fractions every study counts


class SweepPlan(NamedTuple):
    """A study after reading: its points, and the common data of its runs."""

    name: str
    text: str  # the study as YAML
    study: Study
    base: Base
    points: list[Point]
    fingerprint: str  # hash of everything that its rows depend on


def plan(name: str, sets: Sequence[str], only: Sequence[str] = (), *, check_step: bool = False) -> SweepPlan:
    """Read a study by name or path, with `--set` applied to its base run; `check_step` overrides the study's value.

    `only`: the points to run; each text is a column with value patterns, such as `kind=LLC*,HBsWC direct`.

    Raises `InputError` also if its first run is not possible.
    """
    path = find("studies", name)
    content = read_table(path)
    check_kind("studies", content, str(path))
    study = check(Study, content, str(path))
    study = study.model_copy(update={"check_step": study.check_step or check_step})
    return planned(study, path.stem, str(path), read_text(path), sets, only)


def planned(
    study: Study, name: str, source: str, text: str, sets: Sequence[str] = (), only: Sequence[str] = ()
) -> SweepPlan:
    """The plan of a study: `source` begins its error messages, `text` is the copy stored with the results."""
    try:
        fields = {**study.set, **read_sets(sets)[0]}
        asked = tuple(study.margin.criteria) if study.margin else ()
        base = Base(read_run(study.run)[0], source, fields, study.modes or "damping" in asked, study.jacobian, asked)
        study = expand_axis(study, base)
        points = axes.chosen(axes.points(study), only)
        if study.margin is not None:
            check_known("margin.across", study.margin.across, [*IDENTITY, *points[0].columns])
        margin = axes.placed(study.margin, study.margin.low).changes if study.margin else {}
        first = make(base, points[0].changes | margin)
        _check_tables(study, points[0], first)
        changes = [point.changes for point in points]
        code = [_source_hash(*program) for program in dict.fromkeys(_programs([base.content, base.set, *changes]))]
    except InputError as error:
        raise InputError(str(error) if source in str(error) else f"{source}: {error}") from error
    rests_on = [study.model_dump(), *only, base.content, base.set, first.document(), __version__, *code]
    digest = hashlib.sha256(json.dumps(rests_on, sort_keys=True, default=str).encode()).hexdigest()
    return SweepPlan(name, text, study, base, points, digest)


def _source_hash(field: str, text: str) -> str:
    """Hash of the file of a `policy` or `fmu`, which identifies its version. Raises `InputError`."""
    file = text if field == "fmu" else user_code.file_of(user_code.find(text, field))
    return hashlib.sha256(read_bytes(Path(file), FMU)).hexdigest() if Path(file).is_file() else ""


def _programs(content: Any) -> Iterator[tuple[str, str]]:
    """All user programs in the content of runs: the field, and its text or file."""
    if isinstance(content, list):
        for part in content:
            yield from _programs(part)
    elif isinstance(content, dict):
        for name, value in content.items():
            field, text = name.rpartition(".")[2], value.get("file") if isinstance(value, dict) else value
            if field in PROGRAMS and isinstance(text, str):
                yield field, text
            else:
                yield from _programs(value)


def _check_tables(study: Study, first: Point, case: Case) -> None:
    """Raise `InputError` if a table has a column that no row has; `first`, `case`: of the first run."""
    compared = true_jacobian.names(case) if study.jacobian or "jacobian" in study.pictures else []
    if study.tables is None:
        return
    columns = [*IDENTITY, *first.columns]
    for name in study.tables.rows + ([study.tables.across] if study.tables.across else []):
        check_known("tables", name, columns)
    for name in study.tables.figures:
        check_known("tables.figures", name, [*figure_names(modes=study.modes, check_step=study.check_step), *compared])


def run(sweep_plan: SweepPlan, folder: Path, jobs: int, scheduler: str | None, progress: Progress) -> list[PointState]:
    """The rows of a study's points; only runs missing in the folder are made.

    Raises `InputError` if the folder belongs to another study, or if runs cannot be made (`feasibility`), before the
    first of them; `RunError` if the runs cannot continue.
    """
    maximum = len(sweep_plan.points) * (margins.max_runs(sweep_plan.study.margin) if sweep_plan.study.margin else 1)
    with workers(jobs, scheduler) as each:
        if not (folder / JOURNAL).exists():  # a study that goes on was checked when it began
            feasibility.check(sweep_plan.base, _first_tasks(sweep_plan), random_columns(sweep_plan.study), each)
        return _run(sweep_plan, folder, each, maximum, progress)


def _run(sweep_plan: SweepPlan, folder: Path, each: Each, maximum: int, progress: Progress) -> list[PointState]:
    with Journal(files.new_folder(folder) / JOURNAL, sweep_plan.fingerprint, SweepRow.read) as journal:
        write_whole(folder / COPY, sweep_plan.text)
        if journal.damaged:
            lines = f"{journal.damaged} damaged line{'s' if journal.damaged > 1 else ''}"
            note(f"{folder / JOURNAL}: {lines}; those runs are repeated")
        progress.resume(len(journal.rows))
        progress(len(journal.rows), maximum)
        while todo := _tasks(sweep_plan, journal.rows):
            for key, row in each(partial(one_run, sweep_plan.base), todo):
                journal.append(key, row)
                progress(len(journal.rows), maximum)
        return _seen(sweep_plan, journal.rows)


def random_columns(study: Study) -> set[str]:
    """Columns that are random: the seed and what is drawn."""
    return {"seed", *(name for axis in study.sweep for name in axes.drawn_columns(axis))}


def rows(point_states: Sequence[PointState]) -> list[SweepRow]:
    """All rows, by point, then by the value of the margin's field."""
    return [seen[value] for seen in point_states for value in sorted(seen, key=lambda value: value or 0.0)]


def _seen(sweep_plan: SweepPlan, journal_rows: Mapping[str, SweepRow]) -> list[PointState]:
    states: list[PointState] = [{} for _ in sweep_plan.points]
    for key, row in journal_rows.items():
        point, _, value = key.partition(" ")
        states[int(point)][float(value) if value else None] = row
    return states


def _first_tasks(sweep_plan: SweepPlan) -> list[RunRequest]:
    """A run of each point, without its random values: with a margin, the first of its search."""
    low = None if sweep_plan.study.margin is None else sweep_plan.study.margin.low
    random = {path for axis in sweep_plan.study.sweep for v in axes.drawn_variables(axis) for path in v.factors}
    tasks = [_task(sweep_plan, i, low) for i in range(len(sweep_plan.points))]
    plain = [{path: value for path, value in task.changes.items() if path not in random} for task in tasks]
    return [task._replace(changes=changes) for task, changes in zip(tasks, plain, strict=True)]


def _tasks(sweep_plan: SweepPlan, journal_rows: Mapping[str, SweepRow]) -> list[RunRequest]:
    """The next runs; empty when the study is complete. Runs with the same network are adjacent, to share it."""
    requests = [
        _task(sweep_plan, i, value)
        for i, seen in enumerate(_seen(sweep_plan, journal_rows))
        for value in (_wanted(sweep_plan.study.margin, seen) if sweep_plan.study.margin else [None] if not seen else [])
    ]
    if sweep_plan.study.check_step:
        requests = [task._replace(check_step=sweep_plan.study.margin is None) for task in requests] or _ends(
            sweep_plan, journal_rows
        )
    networks: dict[str, list[RunRequest]] = {}
    for task in requests:
        fields = {path: value for path, value in task.changes.items() if path.partition(".")[0] in NETWORK}
        networks.setdefault(json.dumps(fields, default=str), []).append(task)
    return [task for tasks in networks.values() for task in tasks]


def _ends(sweep_plan: SweepPlan, journal_rows: Mapping[str, SweepRow]) -> list[RunRequest]:
    margin = sweep_plan.study.margin
    if margin is None:
        return []
    return [
        _task(sweep_plan, i, value)._replace(check_step=True)
        for i, seen in enumerate(_seen(sweep_plan, journal_rows))
        for value in {
            end: None for criterion in margin.criteria for end in _bracket_ends(_failed(margin, seen, criterion))
        }
        if seen[value].half_step is None
    ]


def _bracket_ends(failed: Mapping[float, bool | None]) -> list[float]:
    bracket = margins.bracket(failed)
    return [value for value in (bracket.low, bracket.high) if value is not None]


def _task(sweep_plan: SweepPlan, i: int, value: float | None) -> RunRequest:
    point = sweep_plan.points[i]
    if sweep_plan.study.margin is None or value is None:
        return RunRequest(str(i), point.changes, point.columns)
    both = axes.joined([point, axes.placed(sweep_plan.study.margin, value)])
    return RunRequest(f"{i} {value!r}", both.changes, both.columns)


def _wanted(margin: Margin, seen: PointState) -> list[float]:
    """Values needed next by a point's search over all criteria, without duplicates."""
    each = [margins.wanted(margin, _failed(margin, seen, criterion)) for criterion in margin.criteria]
    return list(dict.fromkeys(value for values in each for value in values))


def _failed(margin: Margin, seen: PointState, criterion: str) -> dict[float, bool | None]:
    """Whether the run failed at each value; None if it was not possible."""
    return {
        value: None if row.error else fails(criterion, row.judged, margin.damping_ratio)
        for value, row in seen.items()
        if value is not None
    }


def found_margins(sweep_plan: SweepPlan, point_states: Sequence[PointState]) -> list[MarginRow]:
    """A margin for each point and criterion, combining points that differ only by seed or draw."""
    margin = sweep_plan.study.margin
    if margin is None:
        return []
    groups: dict[str, list[PointState]] = {}
    for seen in point_states:
        sample = next((row for row in seen.values() if not row.error), next(iter(seen.values())))
        groups.setdefault(json.dumps({name: sample.cells.get(name) for name in _place(sweep_plan)}), []).append(seen)
    rows = []
    for place, group in groups.items():
        for criterion in margin.criteria:
            searches = [_failed(margin, seen, criterion) for seen in group]
            ends = [seen[v] for seen, search in zip(group, searches, strict=True) for v in _bracket_ends(search)]
            over = margins.over_seeds([margins.bracket(search) for search in searches], margin, sweep_plan.study.seed)
            held, intervals = margins.held(margin, searches), margins.holding(searches)
            changed = differ(ends, criterion)
            converged = not any(changed) if changed else None
            trips = sum(tripped(row) for seen in group for row in seen.values())
            rows.append(MarginRow(json.loads(place), criterion, over, held, intervals, converged, trips))
    return rows


def differ(group_rows: Sequence[SweepRow], criterion: str) -> list[bool] | None:
    """For each run, whether halving the integration step changes failure; None if not checked."""
    finer = [CriterionFigures(row.half_step.verdict_half_step) for row in group_rows if row.half_step is not None]
    if len(finer) < len(group_rows) or criterion not in ALWAYS:
        return None
    return [fails(criterion, row.judged) != fails(criterion, half) for row, half in zip(group_rows, finer, strict=True)]


def swept(sweep_plan: SweepPlan) -> list[str]:
    """Columns that were swept, including the margin's."""
    return [*sweep_plan.points[0].columns, *([sweep_plan.study.margin.column] if sweep_plan.study.margin else [])]


def across(sweep_plan: SweepPlan) -> str:
    """Column whose values are side by side in tables of margins."""
    return sweep_plan.study.margin.across if sweep_plan.study.margin else "scenario"


def _place(sweep_plan: SweepPlan) -> list[str]:
    """Columns that identify a run, without its seed and random values."""
    columns, random = [*IDENTITY, *sweep_plan.points[0].columns, "horizon_s"], random_columns(sweep_plan.study)
    return [name for name in dict.fromkeys(columns) if name not in random]


def found_fractions(sweep_plan: SweepPlan, point_states: Sequence[PointState]) -> list[FractionRow]:
    """The fraction of failed runs over seeds and random values, with Wilson's interval.

    A row for each place and criterion; empty if no two runs share a place.
    """
    columns = _place(sweep_plan) + ([sweep_plan.study.margin.column] if sweep_plan.study.margin else [])
    groups: dict[str, list[SweepRow]] = {}
    for row in rows(point_states):
        if not row.error:
            groups.setdefault(json.dumps({name: row.cells.get(name) for name in columns}), []).append(row)
    if all(len(place_rows) == 1 for place_rows in groups.values()):
        return []
    fractions = []
    for criterion in ALWAYS:
        for place, place_rows in groups.items():
            fraction = margins.failed_fraction(sum(fails(criterion, row.judged) for row in place_rows), len(place_rows))
            changed = differ(place_rows, criterion)
            unsure = None if changed is None else sum(changed)
            trips = sum(map(tripped, place_rows))
            fractions.append(FractionRow(json.loads(place), criterion, fraction, unsure, trips))
    return fractions
