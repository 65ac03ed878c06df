"""Searches and evaluates all arms, for each seed of the search; a folder keeps what was made."""

from __future__ import annotations

import json
from copy import deepcopy
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from facts_damping.analysis.indices import performance_indices
from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.ringdown import fit_ringdown
from facts_damping.analysis.response import MIRROR, swings_of
from facts_damping.case.changes import as_sets, change
from facts_damping.case.loading import changed_case
from facts_damping.output.terminal import Progress
from facts_damping.output.writing import write_whole
from facts_damping.record import RunChange
from facts_damping.simulation import loop
from facts_damping.simulation.changes import rerun
from facts_damping.simulation.twins import twin
from facts_damping_reproduction.adaptation.arms import space
from facts_damping_reproduction.adaptation.cases import BEGIN, evaluation, training
from facts_damping_studies.score.card import log_ratio
from facts_damping_studies.score.entries import NONE
from facts_damping_studies.search.scoring import mean_effort
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from facts_damping.case.model import Case
    from facts_damping.record import Record
    from facts_damping_reproduction.adaptation.arms import Space

PLAN = Path(__file__).with_name("adaptation.yaml")
PROFILE = "deployment"
WHOLE = "whole"  # file of a seed that has all its results
FIRST_GENERATIONS = 6  # of the choice of the network


class Search(NamedTuple):
    """What a search found: controllers, mean log index relative to no control, and the best by generation."""

    rows: list[dict[str, Any]]
    value: float
    curve: list[float]
    loops: int


@cache
def plan() -> dict[str, Any]:
    """The plan of the experiment."""
    content: dict[str, Any] = yaml.safe_load(PLAN.read_text())
    return content


def made(
    devices: Sequence[str],
    sets: dict[str, Any],
    rows: Sequence[dict[str, Any]],
    more: dict[str, Any] | None = None,
) -> Case:
    """A case with devices and controllers."""
    common = {**plan()["set"], "devices": list(devices)}
    content: dict[str, Any] = {"controllers": deepcopy(list(rows))}
    change(content, common, as_sets(common))
    return changed_case(content, "adaptation", {**(more or {}), **sets})


def index(record: Any, begin: float, after: float, deviations: NDArray[np.float64]) -> float:
    """ITAE from the event on, p.u. s^2."""
    t = record.time_s[: len(deviations)]
    inside = (t >= begin) & (t <= begin + 1.5 + after)
    return float(performance_indices(t[inside], deviations[inside], begin)["ITAE"])


def _trained(devices: Sequence[str], rows: Sequence[dict[str, Any]], begin: float) -> list[float | None]:
    """The index in each training case; None: synchronism is lost."""
    after, indices = plan()["evaluation"]["after"], list[float | None]()
    for sets in training(plan()["search"]["cases"], begin, after):
        record = loop.run(made(devices, sets, rows, plan()["search"]["set"]))
        sound = record.in_synchronism.all()
        indices.append(index(record, begin, after, columns(speed_differences(record))) if sound else None)
    return indices


_free = cache(lambda devices, begin: _trained(devices, (), begin))


def objective(devices: Sequence[str], rows: Sequence[dict[str, Any]], begin: float) -> float:
    """Mean log of the index relative to no control over the training cases."""
    pairs = zip(_trained(devices, rows, begin), _free(tuple(devices), begin), strict=True)
    return float(np.mean([log_ratio(a, b) for a, b in pairs if b is not None]))


def search(
    devices: Sequence[str], arm: dict[str, Any], network: dict[str, Any], seed: int, generations: int | None = None
) -> Search:
    """What `evolve` finds for an arm."""
    begin = arm.get("begin", BEGIN)
    where = space(arm, network, devices)
    return evolve(where, lambda rows: objective(devices, rows, begin), plan()["search"], seed, generations)


def evolve(
    where: Space,
    loss: Callable[[list[dict[str, Any]]], float],
    task: dict[str, Any],
    seed: int,
    generations: int | None = None,
) -> Search:
    """Differential evolution until the best of training no longer moves; `task`: the part `search` of a plan."""
    random = np.random.default_rng(seed)
    number = max(task["least"] if where.size > 1 else 8, task["points"] * where.size)
    start = qmc.LatinHypercube(where.size, rng=random).random(number)
    curve: list[float] = []

    def ended(intermediate_result: Any) -> bool:
        curve.append(float(intermediate_result.fun))
        before = curve[-1 - task["patience"]] if len(curve) > task["patience"] else np.inf
        return bool(before - curve[-1] < task["better"])

    optimum = differential_evolution(
        lambda at: loss(where.rows(at)),
        [(0.0, 1.0)] * where.size,
        init=start,
        maxiter=(generations or task["generations"]) - 1,
        rng=random,
        tol=0.0,
        polish=False,
        callback=ended,
    )
    return Search(where.rows(optimum.x), float(optimum.fun), curve, int(optimum.nfev) * task["cases"])


def measured(
    devices: Sequence[str], sets: dict[str, Any], rows: Sequence[dict[str, Any]], *, frozen: bool = False
) -> dict[str, Any]:
    """A controller in an evaluation case: index, peak, lowest damping ratio of the response, effort."""
    begin, after = plan()["evaluation"]["begin"], plan()["evaluation"]["after"]
    case = made(devices, sets, rows)
    if frozen:
        tick = round(begin * case.run.frame_rate)
        roles = ["controller", *(["identifier"] if case.controllers[0].scheme == "indirect" else [])]
        names = {"controller": "eta", "identifier": "identifier_eta"}
        changes = [RunChange(tick, "", role, 0, "parameter", names[role], 0.0) for role in roles]
        record = rerun(case, changes, loop.build_loop(case))
    else:
        record = loop.run(case)
    return outcome(case, record, begin, after)


def outcome(case: Case, record: Record, begin: float, after: float) -> dict[str, Any]:
    """A run with an event at `begin`: index, peak, lowest damping ratio of the response, effort; or that it is lost."""
    if not record.in_synchronism.all():
        return {"lost": True}
    response = swings_of(record, twin(case, record, MIRROR)).judged
    t = record.time_s[: len(response)]
    fit = fit_ringdown(t, response, begin + 1.0)
    return {
        "lost": False,
        "index": index(record, begin, after, response),
        "peak": float(np.abs(response[t >= begin]).max()),
        "damping_ratio": min((mode.damping_ratio for mode in fit.modes), default=None) if fit else None,
        "effort": mean_effort(record) if case.controllers else 0.0,
    }


def _search_task(
    devices: Sequence[str], network: dict[str, Any], task: tuple[str, int]
) -> tuple[str, int, dict[str, Any]]:
    arm, seed = task
    return arm, seed, search(devices, plan()["arms"][arm], network, seed)._asdict()


def _network_task(network: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    devices = next(iter(plan()["sets"].values()))["devices"]
    best = search(devices, {"kind": "network", "learning": True}, network, 0, FIRST_GENERATIONS)
    return json.dumps(network), best._asdict()


def _evaluation_task(
    devices: Sequence[str], cases: list[dict[str, Any]], task: tuple[str, int, list[dict[str, Any]], bool]
) -> Any:
    arm, seed, rows, frozen = task
    return arm, seed, [measured(devices, case["set"], rows, frozen=frozen) for case in cases]


def run(folder: Path, jobs: int, scheduler: str | None, seed: int) -> dict[int, dict[str, dict[str, Any]]]:
    """All searches and evaluations of a seed, and of those that the folder has whole: seed: set of devices: results.

    `seed`: 0 as published, others draw other searches and other evaluation cases.
    """
    with workers(jobs, scheduler) as each:
        _of_seed(folder, seed, each)
    whole = sorted(int(path.parent.name.removeprefix("seed_")) for path in folder.glob(f"seed_*/{WHOLE}"))
    return {whole_seed: _of_seed(folder, whole_seed, map) for whole_seed in whole}


def _of_seed(folder: Path, seed: int, each: Any) -> dict[str, dict[str, Any]]:
    own_folder = folder / f"seed_{seed}"
    results = {
        name: _of_set(own_folder / name.replace(" ", "_"), device_set["devices"], seed, each)
        for name, device_set in plan()["sets"].items()
        if seed in device_set.get("seeds", [seed])
    }
    write_whole(own_folder / WHOLE, "")
    return results


def arms_of(devices: Sequence[str]) -> dict[str, Any]:
    """The arms for these devices: policies are for one."""
    return {name: arm for name, arm in plan()["arms"].items() if arm["kind"] != "policy" or len(devices) == 1}


def _of_set(folder: Path, devices: Sequence[str], seed: int, each: Any) -> dict[str, Any]:
    folder.mkdir(parents=True, exist_ok=True)
    network, arms = _chosen(folder.parent, each), arms_of(devices)
    asked = [name for name, arm in arms.items() if arm["kind"] not in ("fixed", "frozen")]
    todo = [(name, 1000 * seed + s) for s in range(plan()["search"]["seeds"]) for name in asked]
    searched = kept(folder, "search", todo, partial(_search_task, devices, network), each)
    searches = {(name, run_seed): result for name, run_seed, result in searched}
    task = plan()["evaluation"]
    cases = evaluation(task["cases"], task["begin"], task["after"], seed)
    lead = {"name": "LLC", "signals": ["frequency"], "devices": list(devices)}
    tasks: list[Any] = [(NONE, 0, [], False), ("LLC", 0, [lead], False)]
    for (name, search_seed), result in searches.items():
        tasks.append((name, search_seed, result["rows"], False))
        frozen = [other for other, arm in arms.items() if arm.get("of") == name]
        tasks += [(other, search_seed, result["rows"], True) for other in frozen]
    evaluated = kept(folder, "evaluation", tasks, partial(_evaluation_task, devices, cases), each)
    rows = {(name, run_seed): result for name, run_seed, result in evaluated}
    of_cases = {"kinds": [case["kind"] for case in cases], "events": [case["event"] for case in cases]}
    return {"network": network, "arms": list(arms), "searches": searches, "rows": rows, **of_cases}


def _chosen(folder: Path, each: Any) -> dict[str, Any]:
    """The network that is best in training with the first seed and the first set of devices."""
    path = folder / "network.json"
    if not path.exists():
        searches = dict(each(_network_task, plan()["networks"]))
        write_whole(path, json.dumps({name: result["value"] for name, result in searches.items()}))
    values = json.loads(path.read_text())
    chosen: dict[str, Any] = json.loads(min(values, key=values.__getitem__))
    return chosen


def kept(folder: Path, what: str, todo: Sequence[Any], function: Any, each: Any) -> list[tuple[str, int, Any]]:
    """Results of tasks, whose first two parts name them; those in the folder are not computed again."""
    paths = {
        (task[0], task[1]): folder / f"{what}_{task[0].replace(' ', '_').replace(',', '')}_{task[1]}.json"
        for task in todo
    }
    missing = [task for task in todo if not paths[task[0], task[1]].exists()]
    with Progress("adaptation", what) as progress:
        for done, (name, seed, result) in enumerate(each(function, missing)):
            write_whole(paths[name, seed], json.dumps(result))
            progress(len(todo) - len(missing) + done + 1, len(todo))
    return [(name, seed, json.loads(path.read_text())) for (name, seed), path in paths.items()]
