"""Verdicts after small events: a table of confusion over the size of a load step, against the linear loop.

The rule, written before: of sound loops (lowest damping ratio at least 1 %), and of those that learn and are damped
without noise, at most 1 of 100 is called growing or a limit cycle, at any size; of those that grow (faster than 0.05
1/s) and are not called undecided, 95 of 100 are called growing, limit cycle or lost synchronism. A run file, such as
`facts-damping design` writes, is tried without control, as it is, and with its gain times -1, -2, -4 and so on until
the loop grows. The step is of the first load that has at least 1 % of the grid's active power.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

from forced import wilson
from verdicts import BARE, GROWS, LOADS, SOUND, Row, sets_of, truth

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.errors import FactsDampingError
from facts_damping.output.tables import table
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of
from facts_damping.small_signal import modal_tables
from facts_damping_studies.pages import as_csv

SIZES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.3)  # of the load
SHARE = 0.01  # least active power of the load that steps, of the grid's
DURATION = "duration=40"
DELAY = 0.05  # s, on the way to the controllers
QUIET = ("load_noise=null", "measurement.noise={}")
KINDS = ("sound", "learning", "growing")
GAINS = (10, -12, -20)
FACTORS = tuple(-(2.0**k) for k in range(12))
COLUMNS = ("loop", "growth_per_s", "lowest_damping_percent", "size_percent", "without_noise", "runs", "verdicts")
VERDICTS = ("damped", "undecided", "growing", "limit cycle", "forced oscillation", "lost synchronism")
LEARNING = {f"{name} direct": (f"controllers=[{{name: {name}, scheme: direct}}]",) for name in ("ANFBsC", "ANFTSC")}
OF_TWO_AREAS = {
    "no control": ("controllers=[]",),
    "LLC-tuned": (),
    **{f"LLC of gain {gain}": ("controllers.0.name=LLC", f"controllers.0.parameters.gain={gain}") for gain in GAINS},
    "STATCOM": ("devices=[statcom]", "controllers=[{name: LLC, signals: [frequency], devices: [statcom]}]"),
    **LEARNING,
}


class Loop(NamedTuple):
    """A loop: its run and fields, one of KINDS or None; growth (1/s) and lowest damping ratio of the linear loop."""

    run: str
    sets: tuple[str, ...]
    kind: str | None
    growth: float = math.nan
    damping: float = math.nan


def measured(run: str, sets: tuple[str, ...]) -> Loop:
    """A loop with growth and damping of its swings; of no kind if it drifts as fast."""
    largest, modes = truth(Row(run, sets), DELAY)
    case = load_case(run, list(sets))
    drift = max(mode.eigenvalue.real for mode in modal_tables.analyse(case.system, case.run.devices).modes)
    growth = max(-damping * 2 * math.pi * hertz / math.sqrt(1 - damping**2) for damping, hertz in modes)
    kind = "growing" if growth > GROWS else "sound" if modes[0][0] >= SOUND and max(largest, drift) < GROWS else None
    return Loop(run, sets, kind, growth, modes[0][0])


def loops(files: list[str]) -> dict[str, Loop]:
    """The loops by name; those that learn have no linear loop."""
    rows: dict[str, Loop] = {}
    for name, sets in OF_TWO_AREAS.items() if not files else ():
        learning = Loop("two_area_deployment", (*BARE, DURATION, *sets), "learning")
        rows[f"two areas, {name}"] = learning if name in LEARNING else measured(learning.run, learning.sets)
    noise = (*BARE, DURATION, LOADS, "measurement=p_class")
    for file in files:
        name, gain = Path(file).parent.name, load_case(file).controllers[0].parameters["gain"]
        rows[f"{name}, no control"] = measured(file, (*noise, "controllers=[]"))
        rows[f"{name}, designed"] = measured(file, noise)
        for factor in FACTORS:
            wrong = measured(file, (*noise, f"controllers.0.parameters.gain={factor * float(str(gain))}"))
            if wrong.kind == "growing":
                rows[f"{name}, gain times {factor:g}"] = wrong
                break
    return rows


def verdict(task: tuple[Loop, float, int]) -> str:
    """The verdict of a run with a load step; seed 0: without noise."""
    row, size, seed = task
    sets = [*sets_of(Row(row.run, row.sets), DELAY), *([f"seed={seed}"] if seed else QUIET)]
    loads = load_case(row.run, sets).system.loads
    least = SHARE * sum(load.P for load in loads)
    load = next(load for load in loads if least <= load.P)
    step = f"scenario=[{{time: 2.0, kind: load_step, load: {load.name}, change: {size}}}]"
    try:
        record = loop.run(load_case(row.run, [*sets, step]))
    except FactsDampingError as error:
        return f"refused: {error}"
    return summarise(record, method=None, twin=twin_of(record)).verdict


def batched(values: list[str], many: int) -> list[list[str]]:
    """Values in groups of `many`."""
    return [values[i : i + many] for i in range(0, len(values), many)]


def shown(counts: Counter[str]) -> list[str]:
    """Counts of the verdicts."""
    return [str(counts[name]) for name in VERDICTS]


def main(first: int, seeds: int, files: list[str], out: Path) -> None:
    """Print the tables and write all rows as CSV."""
    rows = loops(files)
    for name, row in rows.items():
        print(
            f"{name}: growth {row.growth:.3f} 1/s, damping {100 * row.damping:.2f} %: {row.kind or 'left out'}",
            flush=True,
        )
    cells = [(name, size) for name, row in rows.items() if row.kind for size in SIZES]
    seeded = [(*cell, seed) for cell in cells for seed in (0, *range(first, first + seeds))]
    with ProcessPoolExecutor() as pool:
        verdicts = list(pool.map(verdict, [(rows[name], size, seed) for name, size, seed in seeded], chunksize=4))
    lines, by_kind = [], {(kind, size): Counter[str]() for kind in KINDS for size in SIZES}
    for (name, size), (quiet, *others) in zip(cells, batched(verdicts, seeds + 1), strict=True):
        row, counts = rows[name], Counter(others)
        text = ", ".join(f"{count} {called}" for called, count in counts.most_common())
        figures = f"{row.growth:.3f}", f"{100 * row.damping:.2f}", f"{100 * size:g}"
        lines.append([name, *figures, quiet, str(seeds), text])
        if row.kind and (row.kind != "learning" or quiet == "damped"):
            by_kind[row.kind, size] += counts
    out.mkdir(parents=True, exist_ok=True)
    (out / "event_sizes.csv").write_text(as_csv(COLUMNS, lines), encoding="utf-8")
    summary = []
    for (kind, size), counts in by_kind.items():
        judged = counts.total() - counts["undecided"]
        wrong = counts["damped"] if kind == "growing" else judged - counts["damped"]
        whole = judged if kind == "growing" else counts.total()
        summary.append(
            [kind, f"{100 * size:g}", str(counts.total()), *shown(counts), wilson(wrong, whole) if whole else "-"]
        )
    print("\n".join(table(["loop", "step %", "runs", *VERDICTS, "wrong"], summary, left=1)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", help="run files of `facts-damping design` (the recommended run without)")
    parser.add_argument("--first", type=int, default=101, help="the first of the seeds")
    parser.add_argument("--seeds", type=int, default=20, help="how many")
    parser.add_argument("--out", type=Path, default=Path("results/event_sizes"), help="folder for event_sizes.csv")
    asked = parser.parse_args()
    main(asked.first, asked.seeds, asked.files, asked.out)
