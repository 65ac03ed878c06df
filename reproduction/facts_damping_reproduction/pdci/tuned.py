"""Controllers tuned here against the proportional law, on events that no search has seen.

    python -m facts_damping_reproduction.pdci.tuned results/pdci

writes `tuned.csv` into the folder, and what the searches found as laws, `pdci.yaml`. It takes most of an hour;
searches and cases in the folder are not computed again.
"""

from __future__ import annotations

import sys
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.output.writing import write_whole
from facts_damping.simulation import loop
from facts_damping_reproduction.adaptation import decide
from facts_damping_reproduction.adaptation.arms import Space, space
from facts_damping_reproduction.adaptation.experiment import evolve, index, kept, outcome
from facts_damping_reproduction.adaptation.laws import write_laws
from facts_damping_reproduction.pdci import study
from facts_damping_reproduction.random_cases import number, scaled
from facts_damping_studies.pages import as_csv
from facts_damping_studies.score.card import log_ratio
from facts_damping_studies.score.entries import NONE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping.case.model import Case
    from facts_damping_reproduction.random_cases import Random

Rows = list[dict[str, Any]]
BEGIN = 1.0  # s, of the events
TRAINING, HELD_OUT = 1, 2  # streams of random numbers
SYSTEM, PROFILE = "minniwecc", "thesis"
WHERE = {"system": SYSTEM, "profile": PROFILE, "signals": ("hertz",)}  # of the search spaces


def plan() -> dict[str, Any]:
    """This part of the plan."""
    content: dict[str, Any] = study.plan()["tuned"]
    return content


def _fault_and_trip(random: Random, line: str) -> Rows:
    where, end = number(random, 0.1, 0.9), round(BEGIN + number(random, *plan()["draws"]["fault_s"]), 3)
    fault = {"time": BEGIN, "kind": "fault", "line": line, "location": where}
    return [fault, {"time": end, "kind": "line_out", "line": line}]


def _load_step(random: Random, load: str) -> Rows:
    sign = 1.0 if random.random() < 0.5 else -1.0
    change = sign * number(random, *plan()["draws"]["load_step"])
    return [{"time": BEGIN, "kind": "load_step", "load": load, "change": change}]


EVENTS: dict[str, Callable[[Random, str], Any]] = {  # by kind: the scenario at a place
    "named": lambda _, name: name,
    "brake": lambda _, bus: [{"time": BEGIN, "kind": "brake", "bus": bus, "power": 1400, "duration": 0.5}],
    "generator trip": lambda _, machine: [{"time": BEGIN, "kind": "generator_trip", "machine": machine}],
    "line out": lambda _, line: [{"time": BEGIN, "kind": "line_out", "line": line}],
    "load step": _load_step,
    "fault and trip": _fault_and_trip,
}


def cases(which: str) -> Rows:
    """The cases of `training` or `held_out`: kind, place, and what each sets."""
    random = np.random.default_rng((TRAINING if which == "training" else HELD_OUT, 20261128))
    after = plan()["after"][which]
    return [
        {"kind": kind, "place": place, "set": _drawn(random, EVENTS[kind](random, place), after)}
        for kind, places in plan()[which].items()
        for place in places
    ]


@cache
def _powers() -> dict[str, float]:
    """Fields that the load level scales: of loads, without the ends of DC lines, and of units other than the slack."""
    system = study.made({}).system
    loads = {f"system.loads.{i}.{name}": getattr(load, name) for i, load in enumerate(system.loads) if load.Q
             for name in ("P", "Q")}  # fmt: skip
    return loads | {
        f"system.machines.{i}.P": machine.P for i, machine in enumerate(system.machines) if machine.P is not None
    }


def _drawn(random: Random, scenario: Any, after: float) -> dict[str, Any]:
    draws = plan()["draws"]
    return {
        "scenario": scenario,
        "duration": BEGIN + 1.5 + after,
        **scaled(_powers(), number(random, *draws["load_level"])),
        "link.up.1.delay": number(random, *draws["more_delay_s"]),
        "seed": int(random.integers(2**31)),
    }


def made(sets: dict[str, Any], rows: Sequence[dict[str, Any]]) -> Case:
    """A case with controllers."""
    return study.made({**plan()["set"], **sets, "controllers": list(rows)})


def trained(rows: Sequence[dict[str, Any]]) -> list[float | None]:
    """The index in each training case; None: synchronism is lost."""
    indices = list[float | None]()
    for case in cases("training"):
        record = loop.run(made({**case["set"], **plan()["quick"]}, rows))
        swings = columns(speed_differences(record))
        whole = record.in_synchronism.all()
        indices.append(index(record, BEGIN, plan()["after"]["training"], swings) if whole else None)
    return indices


_free = cache(lambda: trained(()))


def objective(rows: Sequence[dict[str, Any]]) -> float:
    """Mean log of the index relative to no control over the training cases."""
    return float(np.mean([log_ratio(a, b) for a, b in zip(trained(rows), _free(), strict=True)]))


@cache
def _space(arm: str) -> Space:
    return space(plan()["arms"][arm], plan()["network"], study.made({}).run.devices, WHERE)


def _searched(task: tuple[str, int]) -> tuple[str, int, dict[str, Any]]:
    arm, seed = task
    return arm, seed, evolve(_space(arm), objective, plan()["search"], seed)._asdict()


def _measured(task: tuple[str, int, Rows]) -> tuple[str, int, Rows]:
    arm, seed, rows = task
    every = [made(case["set"], rows) for case in cases("held_out")]
    return arm, seed, [outcome(case, loop.run(case), BEGIN, plan()["after"]["held_out"]) for case in every]


def results(folder: Path) -> dict[str, Any]:
    """All searches and held-out cases, as `decide` takes them; those in the folder are not computed again."""
    folder.mkdir(parents=True, exist_ok=True)
    asked = [name for name, arm in plan()["arms"].items() if arm["kind"] != "fixed"]
    todo = [(name, seed) for seed in range(plan()["search"]["seeds"]) for name in asked]
    searched = kept(folder, "search", todo, _searched, map)
    law = [controller.model_dump() for controller in study.made({}).run.controllers]
    tasks = [(NONE, 0, []), (plan()["law"], 0, law), *((name, seed, result["rows"]) for name, seed, result in searched)]
    rows = {(name, seed): measured for name, seed, measured in kept(folder, "held_out", tasks, _measured, map)}
    kinds = [case["kind"] for case in cases("held_out")]
    return {"searches": {(name, seed): result for name, seed, result in searched}, "rows": rows, "kinds": kinds}


def ratios(experiment: dict[str, Any]) -> Rows:
    """Each arm against no control and against the law."""
    ratio = partial(decide.ratio, [experiment], kinds=list(plan()["held_out"]), margin=plan()["margin"])
    pairs = [(arm, against) for arm in plan()["arms"] for against in (NONE, plan()["law"]) if arm != against]
    comparisons = [ratio(arm, against)._asdict() for arm, against in pairs]
    return [
        {**comparison, "cases": len(experiment["kinds"]), **_counted(experiment, comparison["arm"])}
        for comparison in comparisons
    ]


def _counted(experiment: dict[str, Any], arm: str) -> dict[str, Any]:
    """Of an arm: runs that lose synchronism, mean effort, loops of its searches, and their mean in training."""
    runs = [run for (name, _), some in experiment["rows"].items() if name == arm for run in some]
    effort = float(np.mean([run["effort"] for run in runs if not run["lost"]]))
    lost = sum(run["lost"] for run in runs)
    searches = [search for (name, _), search in experiment["searches"].items() if name == arm]
    value = float(np.mean([search["value"] for search in searches])) if searches else None
    return {"lost": lost, "effort": effort, "loops": sum(search["loops"] for search in searches), "training": value}


def laws(experiment: dict[str, Any], folder: Path) -> Path:
    """Write what the searches found as laws, `LQG@pdci.0`."""
    about = "Laws of docs/pdci.md, by the seeds of their searches; objective: mean log ITAE relative to no control."
    command = "python -m facts_damping_reproduction.pdci.tuned results/pdci"
    where = {"system": SYSTEM, "profile": PROFILE, "scenario": "pdci", "command": command}
    return write_laws(experiment["searches"], folder / "pdci.yaml", about, **where)


def main(arguments: Sequence[str]) -> None:
    """Compute, or continue, in the folder that is given."""
    folder = Path(arguments[0])
    experiment = results(folder / "tuned")
    rows = ratios(experiment)
    write_whole(folder / "tuned.csv", as_csv(list(rows[0]), [list(row.values()) for row in rows]))
    print(f"written: {folder / 'tuned.csv'}, {laws(experiment, folder)}")


if __name__ == "__main__":
    main(sys.argv[1:])
