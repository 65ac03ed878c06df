"""Verdicts under noise, judged on cases that they were not made on: a table of confusion, and damping ratios.

Truth is the linear closed loop (`facts-damping margin`). The rule, written before: of sound loops (damping ratio of
the linear loop at least 1 %) 95 % are called damped; of those that grow (faster than 0.05 1/s) 95 % are called growing,
limit cycle or lost synchronism. Damping ratios of the response and of the linear loop differ by at most 0.5 percentage
points where the linear loop has less than 10 %.
"""

from __future__ import annotations

import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.case.supervision import unsupervised
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of
from facts_damping.studies.margins.delay_margin import oscillations
from facts_damping.studies.margins.linear_closed_loop import delayed_loop, eigen, link_delays, sampled

SOUND, GROWS = 0.01, 0.05  # damping ratio; 1/s
SEEDS = range(401, 421)
DELAYS = (0.001, 0.1, 0.2, 0.3, 0.4)  # s
COMMON = ("duration=40", "supervision=null", "arm_at=null")
NOISE = ("load_noise={std: 0.01, time_constant: 1}",)
PULSE = "{time: 2.0, kind: mechanical_power_step, machine: G1, change: -0.1}"
STEP = f"scenario=[{PULSE}, {{time: 2.5, kind: mechanical_power_step, machine: G1, change: 0.0}}]"  # the grid stays
FAULT = "scenario=[{time: 2.0, kind: fault, line: line_1, location: 0.5}, {time: 2.08, kind: clear, line: line_1}]"
LOOPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "two areas, pulse, LLC": ("two_area_deployment", (STEP, "controllers.0.name=LLC")),
    "two areas, fault, LLC": ("two_area_deployment", (FAULT, "controllers.0.name=LLC")),
    "two areas, fault, LLC-tuned": ("two_area_deployment", (FAULT,)),
    "two areas, fault, LLC of wrong sign": (
        "two_area_deployment",
        (FAULT, "controllers.0.name=LLC", "controllers.0.parameters.gain=-20"),
    ),
    "two areas, fault, LLC of double gain": (
        "two_area_deployment",
        (FAULT, "controllers.0.name=LLC", "controllers.0.parameters.gain=20"),
    ),
    "infinite bus, LLC": ("lead_lag_smib", (*NOISE, "scenario=nominal", "controllers=[{name: LLC}]")),
    "infinite bus, LLC of wrong sign": (
        "lead_lag_smib",
        (*NOISE, "scenario=nominal", "controllers=[{name: LLC, parameters: {gain: -10}}]"),
    ),
}


def link(delay: float) -> str:
    """A constant delay."""
    return f"link={{up: [{{stage: network, model: constant, delay: {delay}}}], down: []}}"


def truth(name: str, delay: float) -> tuple[float, float, float]:
    """Growth rate (1/s), lowest damping ratio and its frequency (Hz), of the linear loop."""
    run, sets = LOOPS[name]
    case = load_case(run, [*COMMON, *sets, link(delay)])
    made = delayed_loop(unsupervised(case))
    found = eigen(made, sampled(made, min(link_delays(case))))
    modes = [m for m in oscillations(made, found, case) if m.swings]
    lowest = min(modes, key=lambda m: m.damping_ratio)
    return found.growth, lowest.damping_ratio, lowest.frequency_hz


def seen(task: tuple[str, float, int]) -> tuple[str, float, str, str, float | None]:
    """Verdict with and without twin, and the damping ratio of the strongest mode of the response."""
    name, delay, seed = task
    run, sets = LOOPS[name]
    record = loop.run(load_case(run, [*COMMON, *sets, link(delay), f"seed={seed}"]))
    plain, summary = summarise(record, method=None), summarise(record, twin=twin_of(record))
    ratios = [mode["damping_ratio"] for mode in summary["modes"]]
    return name, delay, plain["verdict"], summary["verdict"], ratios[0] if ratios else None


def words(verdicts: list[str]) -> str:
    """Verdicts by their number."""
    return ", ".join(f"{count} {verdict}" for verdict, count in Counter(verdicts).most_common())


def main(names: list[str]) -> None:
    """Print both tables in Markdown."""
    tasks = [(name, delay, seed) for name in names or LOOPS for delay in DELAYS for seed in SEEDS]
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(seen, tasks, chunksize=8))
    right: dict[str, list[bool]] = {"sound": [], "grows": []}
    unpaired: dict[str, list[bool]] = {"sound": [], "grows": []}
    print("| loop | delay, ms | linear: damping ratio, % | response, % (seeds) | verdicts | without twin |")
    print("|---|--:|--:|--:|---|---|")
    for name in names or LOOPS:
        for delay in DELAYS:
            growth, ratio, _ = truth(name, delay)
            own = [row for row in found if row[:2] == (name, delay)]
            ratios = 100 * np.array([row[4] for row in own if row[4] is not None])
            kind = "sound" if ratio >= SOUND and growth < 0 else "grows" if growth > GROWS else None
            if kind:
                held: Any = (
                    (lambda v: v == "damped") if kind == "sound" else (lambda v: v not in ("damped", "undecided"))
                )
                right[kind] += [held(row[3]) for row in own]
                unpaired[kind] += [held(row[2]) for row in own]
            span = f"{np.median(ratios):.2f} [{ratios.min():.2f}, {ratios.max():.2f}]" if len(ratios) else "-"
            print(f"| {name} | {1e3 * delay:.0f} | {100 * ratio:.2f} | {span} |", end=" ")
            print(f"{words([row[3] for row in own])} | {words([row[2] for row in own])} |", flush=True)
    print("\n| the linear loop | runs | called so | without twin |\n|---|--:|--:|--:|")
    for kind, verdict in (("sound", "damped"), ("grows", "growing, limit cycle or lost")):
        n = len(right[kind])
        print(
            f"| {kind} | {n} | {verdict}: {100 * np.mean(right[kind]):.1f} % | {100 * np.mean(unpaired[kind]):.1f} % |"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
