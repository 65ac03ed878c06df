"""Arms beside each other: searches, unseen cases, ratios by the rule, damping ratios, the claim, delays, failures."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import read_run
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of
from facts_damping.small_signal.modal_tables import analyse
from facts_damping_reproduction.adaptation import decide
from facts_damping_reproduction.adaptation.cases import evaluation
from facts_damping_reproduction.adaptation.experiment import kept, outcome
from facts_damping_reproduction.inverters.laws import BARE, MAIN, Arm, arms, searched, without_control
from facts_damping_reproduction.inverters.study import STILL, interarea, made, plan
from facts_damping_studies.margins.delay_margin import oscillations
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, sampled
from facts_damping_studies.score.entries import NONE

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from facts_damping_studies.sweeps.pool import Each

Rows = list[dict[str, Any]]
RUN = "two_area_ibr_pod"
SUPERVISED = {"supervision": "standard", "arm_at": 0.5}


class Compared(NamedTuple):
    """Of a part of the plan: what searches found, outcomes in the unseen cases by arm and seed, kinds of the cases."""

    searches: dict[tuple[str, int], dict[str, Any]]
    rows: dict[tuple[str, int], list[dict[str, Any]]]
    kinds: list[str]

    def best(self, arm: Arm) -> list[dict[str, Any]]:
        """The controller of an arm that was best in training, or that it has anyway."""
        of_arm = [search for (name, _), search in sorted(self.searches.items()) if name == arm.name]
        best: list[dict[str, Any]] = min(of_arm, key=lambda search: search["value"])["rows"] if of_arm else arm.fixed
        return best


def cases() -> Rows:
    """The unseen cases: kind, and what each sets."""
    asked = plan()["cases"]
    every = evaluation(asked["number"], asked["begin"], asked["after"], asked["seed"])
    return [case for case in every if case["kind"] in asked["kinds"]]


def arm_of(part: str, name: str) -> Arm:
    """An arm by name, or the grid without control."""
    return without_control(part) if name == NONE else arms(part)[name]


def _measured(part: str, task: tuple[str, int, list[dict[str, Any]]]) -> tuple[str, int, list[dict[str, Any]]]:
    name, seed, rows = task
    arm, asked, results = arm_of(part, name), plan()["cases"], []
    for unseen in cases():
        case = made({**unseen["set"], **arm.sets}, rows, arm.devices)
        results.append(outcome(case, loop.run(case), asked["begin"], asked["after"]))
    return name, seed, results


def compared(part: str, folder: Path, each: Each) -> Compared:
    """Searches and outcomes of a part of the plan; what the folder has is not computed again."""
    folder.mkdir(parents=True, exist_ok=True)
    todo = [
        (name, seed) for seed in range(plan()["search"]["seeds"]) for name, arm in arms(part).items() if arm.searched
    ]
    searches = {
        (name, seed): search for name, seed, search in kept(folder, "search", todo, partial(searched, part), each)
    }
    tasks: list[Any] = [(NONE, 0, [])]
    tasks += [(name, 0, arm.fixed) for name, arm in arms(part).items() if not arm.searched]
    tasks += [(name, seed, search["rows"]) for (name, seed), search in searches.items()]
    outcomes = kept(folder, "unseen", tasks, partial(_measured, part), each)
    return Compared(searches, {(name, seed): rows for name, seed, rows in outcomes}, [case["kind"] for case in cases()])


def ratio(results: Compared, arm: str, against: str, reference: str = NONE) -> decide.Ratio:
    """Index of an arm relative to another; `reference`: an arm, relative to which both are taken in each case."""
    experiment = {"rows": {**results.rows, (NONE, 0): results.rows[reference, 0]}, "kinds": results.kinds}
    return decide.ratio([experiment], arm, against, plan()["cases"]["kinds"], plan()["margin"])


def damping(arm: Arm, rows: Sequence[dict[str, Any]], delay: float | None = None) -> dict[str, Any]:
    """Damping ratio and frequency of the interarea mode, and the largest growth (1/s, Hz), in the linear loop."""
    case = made({**arm.sets, "scenario": []}, rows, arm.devices)
    if rows:
        whole = delayed_loop(case)
        solved = eigen(whole, sampled(whole, plan()["typical"] if delay is None else delay))
        modes, fastest = oscillations(whole, solved, case), solved.values[0]
    else:
        modes = analyse(case.system, case.run.devices).modes
        fastest = max((m.eigenvalue for m in modes if abs(m.eigenvalue) > STILL), key=lambda value: value.real)
    between = interarea(modes)
    return {
        "damping_ratio": between and between.damping_ratio,
        "frequency_hz": between and between.frequency_hz,
        "growth": float(fastest.real),
        "growth_hz": abs(float(fastest.imag)) / (2.0 * math.pi),
    }


def ratios(results: Compared) -> Rows:
    """Each arm against no control, and against the others, with its damping ratio, losses and effort."""
    pairs = [(arm, NONE) for arm in plan()[MAIN]]
    pairs += [(arm, other) for arm in plan()[MAIN] for other in plan()[MAIN] if arm != other]
    linear = {name: damping(arm, results.best(arm)) for name, arm in arms(MAIN).items()}
    return [
        {**ratio(results, arm, against)._asdict(), **linear[arm], **_counted(results, arm)} for arm, against in pairs
    ]


def _counted(results: Compared, name: str) -> dict[str, Any]:
    runs = [run for (arm, _), some in results.rows.items() if arm == name for run in some]
    sound = [run for run in runs if not run["lost"]]
    runs_of_arm = [search for (arm, _), search in results.searches.items() if arm == name]
    return {
        "runs": len(runs),
        "lost": len(runs) - len(sound),
        "effort": sum(run["effort"] for run in sound) / max(1, len(sound)),
        "loops": sum(search["loops"] for search in runs_of_arm),
    }


def claim(results: Compared) -> Rows:
    """The claim's comparisons, by the index and by the damping ratio of the interarea mode."""
    values = {
        name: [search["value"] for (arm, _), search in results.searches.items() if arm == name]
        for name in ("POD-P", "POD-Q")
    }
    pod = min(values, key=lambda name: sum(values[name]) / len(values[name]))
    linear = {name: damping(arm, results.best(arm))["damping_ratio"] for name, arm in arms(BARE).items()}
    reference, margin, as_good = "PSS", plan()["margin"], plan()["claim"]["as_good"]
    rows = []
    for arm, against in (("VSM", "PSS"), ("VSM", pod), ("PSS", pod)):
        index = ratio(results, arm, against, reference)
        times = linear[arm] / linear[against]
        if against == "PSS":
            by_index = _held(index.high <= 1.0 + as_good, index.low > 1.0 + as_good)
            by_ratio = _held(times >= 1.0 - as_good, times < 1.0 - as_good)
        else:
            by_index = _held(index.high < 1.0 - margin, index.low > 1.0 - margin)
            by_ratio = _held(times > 1.0 + margin, times <= 1.0 + margin)
        rows.append(
            {
                "arm": arm,
                "against": against,
                **{name: getattr(index, name) for name in ("ratio", "low", "high")},
                "by_index": by_index,
                "damping_ratio": linear[arm],
                "damping_ratio_of_other": linear[against],
                "by_damping_ratio": by_ratio,
            }
        )
    return rows


def _held(holds: bool, fails: bool) -> str:
    return "confirmed" if holds else "refuted" if fails else "open"


def delays(results: Compared) -> Rows:
    """Damping ratio of the interarea mode and growth against the delay, of the best controllers in training."""
    return [
        {"arm": name, "delay_s": delay, **damping(arms(MAIN)[name], results.best(arms(MAIN)[name]), delay)}
        for name in plan()["failed"]
        for delay in plan()["delays"]
    ]


def _failed(results: Compared, task: tuple[str, str, bool]) -> dict[str, Any]:
    name, failure, supervised = task
    arm = arms(MAIN)[name]
    rows = results.best(arm)
    events, sets = {"scenario": read_run(RUN)[0]["scenario"], "duration": 20.0}, {**arm.sets}
    record = loop.run(made({**events, **sets}, (), arm.devices))
    none = summarise(record, twin=twin_of(record)).indices
    record = loop.run(
        made({**events, **sets, **plan()["failures"][failure], **(SUPERVISED if supervised else {})}, rows, arm.devices)
    )
    summary = summarise(record, twin=twin_of(record))
    itae = summary.indices and summary.indices["ITAE"]
    return {
        "arm": name,
        "failure": failure,
        "supervised": supervised,
        "verdict": summary.verdict,
        "ITAE": itae,
        "of_none": itae / none["ITAE"] if itae and none else None,
    }


def failures(results: Compared, each: Each) -> Rows:
    """Each failure of each controller, without a supervisor and with one."""
    tasks = [
        (name, failure, flag) for name in plan()["failed"] for failure in plan()["failures"] for flag in (False, True)
    ]
    rows = {(row["arm"], row["failure"], row["supervised"]): row for row in each(partial(_failed, results), tasks)}
    return [rows[task] for task in tasks]
