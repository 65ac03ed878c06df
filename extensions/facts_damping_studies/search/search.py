"""Search of a controller: successive halving over structures, and an evolutionary search of each one's parameters.

For n structures and a budget of B closed-loop runs there are floor(log4 n) rungs. Each has an equal fraction of B,
divided among the remaining structures; the best quarter goes on (Jamieson and Talwalkar 2016 keep half). In a rung
each structure is searched by differential evolution or CMA-ES (optimisers.py), on twice as many draws of the training
ensemble as in the rung before, and it keeps its population. LLC-tuned stays to the end. The structures of the last
rung are compared on draws that no rung has used, again twice as many, and the best is chosen.
"""

from __future__ import annotations

import math
from functools import lru_cache, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import norm, qmc

from facts_damping.case.loading import load_system
from facts_damping.control.compensation import COMPENSATIONS, OF_IDENTIFIERS
from facts_damping.control.table import kind
from facts_damping.errors import InputError
from facts_damping.output.terminal import note
from facts_damping.parameters.profile import DEFAULT_PROFILE
from facts_damping_studies.search.optimisers import METHODS
from facts_damping_studies.search.scoring import REFERENCE, Draw, Score, draws, ensemble, score
from facts_damping_studies.search.structures import Choice, Structure, started, structures
from facts_damping_studies.sweeps.pool import run_all

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.parameters.run import Controller
    from facts_damping_studies.sweeps.enumerated_axes import Scheme

KEPT = 4  # one of this many structures goes on
POPULATION = 16
GROWTH = 2  # ratio of the draws of a rung to those of the rung before
RUNGS = 3  # if no structure is dropped
# Compensation of delay: free choice if a link has delay; none; always some.
CHOICES = {
    "free": (*COMPENSATIONS, *OF_IDENTIFIERS),
    "none": (),
    "some": (*(name for name in COMPENSATIONS if name != "none"), *OF_IDENTIFIERS),
}
OPTIONS = (
    *("profile", "link", "devices", "signals", "study", "against", "compensation", "cases", "worst", "start"),
    *("deviation", "method", "scheme"),
)
FLAGS = ("medians", "keep_all")


class SearchTask(NamedTuple):
    """Specification of a search, with its budget of closed-loop runs."""

    system: str
    link: str | None
    devices: tuple[str, ...]  # none: all of the system's
    budget: int
    seed: int
    cases: int = 1  # training cases in the first rung
    study: str | None = None  # study that the draws are of; None: search_<system>
    worst: int = 100  # percentage of draws that count: the worst for each index
    medians: bool = False  # use medians over groups of draws instead of means
    start: str = "hypercube"  # first points of each structure; tuned: the result of `tune`, or of a run, is among them
    deviation: float | None = None  # standard deviation of the other first points around those; None: a Latin hypercube
    method: str = "differential-evolution"  # one of METHODS
    scheme: Scheme = None  # scheme of the networks; None: both
    profile: str = DEFAULT_PROFILE
    against: str = REFERENCE  # reference of the scores: LLC-tuned as shipped, or `none` for no control
    compensation: str = "free"  # one of CHOICES
    keep_all: bool = False  # no structure is dropped; all have the same budget
    signals: tuple[str, ...] = ()  # for devices not in `structures.PORTS`

    def command(self, names: Sequence[str]) -> str:
        """The command that repeats this search."""
        asked = {**self._asdict(), "devices": ",".join(self.devices) or None}
        asked["signals"] = ",".join(self.signals) or None
        more = [
            f"--{name} {asked[name]}" for name in OPTIONS if asked[name] not in (None, self._field_defaults.get(name))
        ]
        more += [f"--{name.replace('_', '-')}" for name in FLAGS if asked[name]]
        words = ["facts-damping search", self.system, *names, *more]
        return " ".join([*words, f"--budget {self.budget} --seed {self.seed}"])


class Rung(NamedTuple):
    """A rung: its number from 0, its draws, and the generations of each structure."""

    number: int
    draws: list[Draw]
    generations: int


class Entry(NamedTuple):
    """State of the search of one structure."""

    structure: Structure
    population: NDArray[np.float64] | None = None  # (points, coordinates)
    controller: Controller | None = None
    scores: tuple[Score, ...] = ()  # one per rung; after the last rung also the score on fresh draws

    @property
    def rank(self) -> tuple[int, float]:
        """Sorting key: the number of rungs completed, then the score in the last one."""
        return -len(self.scores), self.scores[-1].value


def rungs(count: int) -> int:
    """The number of rungs for this many structures."""
    return max(1, int(math.log(count, KEPT) + 1e-9))


_choice = lru_cache(maxsize=4)(Choice)


def compensations(task: SearchTask) -> tuple[str, ...]:
    """The compensations that a search chooses from; empty: no choice."""
    delayed = task.link is not None or task.profile != DEFAULT_PROFILE
    return CHOICES[task.compensation] if delayed else ()


def climb(task: SearchTask, rung: Rung, entry: Entry) -> Entry:
    """Search a structure through one rung and return its new state."""
    choice = _choice(entry.structure, task.system, compensations(task))
    random = np.random.default_rng([task.seed, rung.number])
    start = _first(task, choice, random) if entry.population is None else entry.population

    def objective(at: NDArray[np.float64]) -> float:
        return _score(task, choice.controller(at), rung.draws).value

    optimum = METHODS[task.method](objective, start, rung.generations, random)
    best = choice.controller(optimum.best)
    scores = (*entry.scores, _score(task, best, rung.draws))
    return entry._replace(population=optimum.population, controller=best, scores=scores)


def _first(task: SearchTask, choice: Choice, random: np.random.Generator) -> NDArray[np.float64]:
    """The first points of a structure's search."""
    known = choice.starts(task.start)[:POPULATION]
    points: NDArray[np.float64] = qmc.LatinHypercube(choice.size, rng=random).random(POPULATION)
    if known and task.deviation is not None:
        points = (np.resize(known, points.shape) + task.deviation * norm.ppf(points)).clip(0.0, 1.0)
    for i, point in enumerate(known):
        points[i] = point
    return points


def _score(task: SearchTask, controller: Controller, against: Sequence[Draw]) -> Score:
    return score(controller, against, task.worst, medians=task.medians)


def judge(task: SearchTask, against: Sequence[Draw], entry: Entry) -> Entry:
    """Score a structure's best controller on draws that no rung has used."""
    assert entry.controller is not None  # noqa: S101 (for the types: it has climbed)
    return entry._replace(scores=(*entry.scores, _score(task, entry.controller, against)))


def search(task: SearchTask, names: Sequence[str], jobs: int, progress: Callable[[int, int], None]) -> list[Entry]:
    """Search all structures and return them, the best first."""
    ensemble(task.system, task.study, task.profile)  # whose message says which systems there are
    asked = structures(load_system(task.system), names, task.devices, task.scheme, task.profile, task.signals)
    if task.compensation == "some":
        asked = [structure for structure in asked if kind(structure.name).compensates]
    _check_start(task, asked)
    left, out = [Entry(structure) for structure in asked], list[Entry]()
    maximum = RUNGS if task.keep_all else rungs(len(left))
    last = task.cases * GROWTH ** (maximum - 1)
    known = draws(task.system, task.link, last + GROWTH * last, task.study, task.profile, task.against)
    counts, references = [len(left)], sum(entry.structure.is_reference for entry in left)
    for _ in range(maximum - 1):  # a quarter of the networks goes on, plus LLC-tuned
        counts.append(counts[-1] if task.keep_all else math.ceil((counts[-1] - references) / KEPT) + references)
    counts.append(counts[-1])  # the last count again, for the fresh draws
    climbed = []
    for number in range(maximum):
        cases = known[: task.cases * GROWTH**number]
        generations = task.budget / (maximum * counts[number] * len(cases)) / POPULATION
        climbed.append(Rung(number, cases, max(1, round(generations))))
    _warn_of_small_budget(task, climbed, counts)
    for rung in climbed:
        left = run_all(partial(climb, task, rung), left, jobs, _progress_of_rung(progress, counts, rung.number))
        ranked = sorted(left, key=lambda entry: (not entry.structure.is_reference, *entry.rank))
        left, out = ranked[: counts[rung.number + 1]], [*out, *ranked[counts[rung.number + 1] :]]
    left = run_all(partial(judge, task, known[last:]), left, jobs, _progress_of_rung(progress, counts, maximum))
    return sorted([*left, *out], key=lambda entry: entry.rank)


def _warn_of_small_budget(task: SearchTask, climbed: Sequence[Rung], counts: Sequence[int]) -> None:
    """Warn if only the first points are tried, as each rung has at least one generation."""
    if all(rung.generations == 1 for rung in climbed):
        minimum = [POPULATION * count * len(rung.draws) for rung, count in zip(climbed, counts, strict=False)]
        text = f"only the first {POPULATION} points of {counts[0]} structures are tried: {sum(minimum)} closed loops"
        enough = 2 * len(climbed) * max(minimum)
        note(f"--budget {task.budget}: {text}; two generations need {enough}")


def _check_start(task: SearchTask, asked: Sequence[Structure]) -> None:
    if task.start == "hypercube":
        if task.deviation is not None:
            allowed = "with tuned, or a run"
            raise InputError(f"--deviation: {task.deviation} given with --start hypercube; allowed: {allowed}")
        return
    if any(started(task.start, task.system, structure) for structure in asked):
        return
    ports = dict.fromkeys(f"{'+'.join(s.devices)} with {'+'.join(s.signals)} ({s.scheme or s.name})" for s in asked)
    raise InputError(f"--start: '{task.start}' given; allowed: one whose controllers command {', or '.join(ports)}")


def _progress_of_rung(
    progress: Callable[[int, int], None], counts: Sequence[int], number: int
) -> Callable[[int, int], None]:
    return lambda done, _: progress(sum(counts[:number]) + done, sum(counts))
