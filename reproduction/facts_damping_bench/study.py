"""All programs side by side in one run: they take turns, so that what slows the machine hits all alike."""

from __future__ import annotations

from contextlib import ExitStack
from importlib.metadata import version
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from facts_damping import __version__
from facts_damping.errors import RunError
from facts_damping_bench.figures import Result, Sweep, difference, rung, sweep_step
from facts_damping_bench.grid import SHOWN
from facts_damping_bench.programs import OURS, PROGRAMS, Program, missing
from facts_damping_bench.session import Session, session

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

T = TypeVar("T")
REPEATS = 5
VARIED = {OURS: 100}  # runs of a sweep
OTHERS = 5
SPREAD = 0.1  # of the load in a sweep, about 1


class Field(NamedTuple):
    """The programs that still run, each in its process, what was found of each, and the turns each has left."""

    table: Mapping[str, Program]
    sessions: dict[str, Session]
    results: dict[str, Result]
    left: dict[str, int]
    tell: Callable[[], None]


def each(field: Field, act: Callable[[str, Session, Program], T]) -> dict[str, T]:
    """Do something with every program that still runs; one that fails is left out from then on, but not ours."""
    answers = {}
    for name, program in list(field.sessions.items()):
        try:
            answers[name] = act(name, program, field.table[name])
            field.left[name] -= 1
        except RunError as error:
            if name == OURS:
                raise
            note(field, name, failed=str(error))
            del field.sessions[name]
            field.left[name] = 0
        field.tell()
    return answers


def note(field: Field, name: str, **results: Any) -> None:
    """Enter what was found of a program."""
    field.results[name] = field.results[name]._replace(**results)


def measure(
    names: Sequence[str],
    progress: Callable[[int, int], None],
    repeats: int = REPEATS,
    table: Mapping[str, Program] = PROGRAMS,
    *,
    finer: int = SHOWN.finer,
    sweep: bool = True,
) -> list[Result]:
    """Ladders of steps, sweeps, and the difference from ours, of these programs; ours is always there, and first."""
    wanted = list(dict.fromkeys([OURS, *names]))
    there = [name for name in wanted if not missing(table[name].distributions)]
    rungs = max(len(table[name].steps) for name in there)
    turns = 3 + rungs * repeats + (OTHERS if sweep else 0)
    left = dict.fromkeys(there, turns)
    of = len(there) * turns
    field = Field(table, {}, {}, left, lambda: progress(of - sum(left.values()), of))
    for name in wanted:
        row = table[name]
        lacking = missing(row.distributions)
        known = "" if lacking else version(row.distributions[0]) if row.distributions else __version__
        field.results[name] = Result(name, row.title, known, row.note, lacking)
    field.tell()
    with ExitStack() as stack:
        for name in there:
            field.sessions[name] = stack.enter_context(session(table[name].module))
        _measure(field, repeats, rungs, finer)
        if sweep:
            _sweep(field)
    return [field.results[name] for name in wanted]


def _measure(field: Field, repeats: int, rungs: int, finer: int) -> None:
    """From programs that are starting to their ladders."""
    each(field, lambda _name, program, _row: program.read())
    each(field, lambda _name, program, row: program.ask(row.steps[0]))  # warm: not counted
    fine = each(field, lambda _name, program, row: program.ask(row.steps[-1] / finer)["swings"])
    _compare(field, fine, field.table[OURS].steps[-1] / finer)
    runs: dict[tuple[str, float], list[dict[str, Any]]] = {}
    for _ in range(repeats):
        for i in range(rungs):
            answers = each(field, lambda _name, p, row, i=i: p.ask(row.steps[i]) if i < len(row.steps) else None)  # type: ignore[misc]
            for name, run in answers.items():
                if run is not None:
                    runs.setdefault((name, field.table[name].steps[i]), []).append(run)
    for name in list(field.sessions):
        steps = field.table[name].steps
        ladder = tuple(rung(step, fine[name], runs[name, step]) for step in steps)
        note(field, name, rungs=ladder, reference_step_s=steps[-1] / finer)


def _compare(field: Field, fine: Mapping[str, Any], step: float) -> None:
    """The fine run of each beside ours, of `step` s, with the machine's equations that it has."""
    for name, swings in fine.items():
        row = field.table[name]
        if name != OURS:
            twin = field.sessions[OURS].ask(step, model=row.model, more=row.more)["swings"]
            note(field, name, from_ours=difference(swings, twin))


def _sweep(field: Field) -> None:
    """Runs of varied load, in as many turns for each; of ours several a turn."""
    took: dict[str, list[float]] = {}

    def some(name: str, program: Session, _row: Program, turn: int) -> None:
        many = VARIED.get(name, OTHERS) // OTHERS
        step = sweep_step(field.results[name].rungs)
        for i in range(many):
            fraction = (turn * many + i + 0.5) / (many * OTHERS)
            took.setdefault(name, []).append(program.ask(step, 1.0 + SPREAD * (fraction - 0.5))["total_s"])

    for turn in range(OTHERS):
        each(field, lambda name, program, row, turn=turn: some(name, program, row, turn))  # type: ignore[misc]
    for name in field.sessions:
        figures = Sweep(sweep_step(field.results[name].rungs), len(took[name]), median(took[name]))
        note(field, name, sweep=figures)
