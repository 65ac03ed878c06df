"""Forced or natural: a table of confusion, on runs that the rule was not made on (`facts_damping/analysis/forced.py`).

    python benchmarks/forced.py [--first 4001] [--seeds 20] [--out DIRECTORY] [--monitor] [ROW ...]

Truth is known by construction, on two areas in the profile deployment, all noise on, stabilisers set so that the
interarea mode has the damping ratio of the row. Forced: a machine's mechanical power or a load oscillates from 2 s on,
at the mode's frequency, 5 or 20 % above it, or at 0.25 Hz, far from all modes, so that the largest speed difference
swings by the row's mHz in a run without noise. Natural: after a fault, or in noise alone, with damping, with growth, or
as limit cycle of a controller of the wrong sign at its limits.

The rule, written before: of 100 runs 95 are called so; `undecided` is not right. It is counted twice: as `analyze`
judges (by the twin that separates noise), and from the record alone, as of a stream of PMUs.

`--monitor` counts what a supervisor's monitor `forced` says (forced, or it does not act), in runs of four minutes: in
shadow, so that the mode has the damping of the row; the limit cycle with the monitors off that would trip it. A third
size is 60 mHz: waves within the noise of the mode it does not see.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import stats

from facts_damping.analysis import forced
from facts_damping.analysis.measures import columns, event_times, speed_differences
from facts_damping.analysis.summary import summarise
from facts_damping.analysis.verdict import FORCED, UNDECIDED
from facts_damping.case.loading import load_case
from facts_damping.monitor_table import CODES, MONITORS
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of
from facts_damping.small_signal import modal_tables
from facts_damping_studies.pages import as_csv

SEEDS, FIRST = 20, 4001
BARE = ("supervision=null", "arm_at=null")
FREE = (*BARE, "controllers=[]")
WRONG = (
    "controllers=[{name: LLC, signals: [frequency], parameters: {gain: -20}}]",
    "system.devices.*.setpoint_max=0.01",
)
FAR = 0.25  # Hz
DAMPED = 15.0  # gain of the stabilisers in forced runs
GAINS = {"3 %": 21.0, "2 %": 18.0, "1 %": 15.0, "0.5 %": 13.5, "growing": 9.0}  # of the stabilisers, by damping ratio
SOURCES = {"machine": "machine: G2", "load": "load: load_2"}
DISTANCES = {"at the mode": 1.0, "5 % off": 1.05, "20 % off": 1.2, "far": 0.0}
SIZES = (5.0, 20.0)  # mHz
NOISES = (0.003, 0.01)  # of each load, of even and of odd seeds
FAULT = "scenario=[{time: 2.0, kind: fault, line: line_1, location: 0.5}, {time: 2.08, kind: clear, line: line_1}]"
SIDES = {"analyze": "right by `analyze`", "record_alone": "right from the record alone"}
MONITOR = {"monitor": "right by the monitor"}
SHADOW = ("supervision=standard", "arm_at=null")
WATCHED_GAINS = {"10 %": 70.0, "5 %": 30.0, "3 %": 21.0, "2 %": 18.0, "1 %": 15.0}
WATCHED_SIZES = (*SIZES, 60.0)  # mHz
WATCHED_S = 240.0  # s
UNTRIPPED = [f"supervision.monitors.{name}=off" for name in MONITORS if name != "forced"]


class Row(NamedTuple):
    """A kind of run: truth, gain of the stabilisers, duration, fields; source, place and size (mHz) of a forced one."""

    truth: str
    gain: float
    seconds: float
    sets: tuple[str, ...] = FREE
    source: str = ""
    distance: str = ""
    mhz: float = 0.0


def rows() -> dict[str, Row]:
    """All rows by name."""
    table = {
        f"forced, {source}, {distance}, {mhz:g} mHz": Row(forced.FORCED, DAMPED, 60, FREE, source, distance, mhz)
        for source in SOURCES
        for distance in DISTANCES
        for mhz in SIZES
    }
    for label, gain in GAINS.items():
        table[f"natural, {label}, fault"] = Row(forced.NATURAL, gain, 60, (*FREE, FAULT))
        if label != "growing":
            table[f"natural, {label}, noise alone"] = Row(forced.NATURAL, gain, 120, (*FREE, "scenario=[]"))
    return table | {"limit cycle, fault": Row(forced.NATURAL, 21.0, 60, (*BARE, *WRONG, FAULT))}


def watched_rows() -> dict[str, Row]:
    """Rows for the monitor, by name: with a supervisor in shadow, or with one that trips nothing."""
    table = {
        f"forced, load, {distance}, {mhz:g} mHz": Row(forced.FORCED, DAMPED, WATCHED_S, SHADOW, "load", distance, mhz)
        for distance in DISTANCES
        for mhz in WATCHED_SIZES
    }
    for label, gain in WATCHED_GAINS.items():
        for kind, more in {"fault": FAULT, "noise alone": "scenario=[]"}.items():
            table[f"natural, {label}, {kind}"] = Row(forced.NATURAL, gain, WATCHED_S, (*SHADOW, more))
    cycling = ("supervision=standard", "arm_at=0.5", *UNTRIPPED, *WRONG, FAULT)
    return table | {"limit cycle, fault": Row(forced.NATURAL, 21.0, WATCHED_S, cycling)}


def sets_of(row: Row, seed: int, noise: float) -> list[str]:
    """Fields of a run of a row; those of a forced one with its source."""
    sets = [*row.sets, f"system.stabilisers.*.K={row.gain}", f"duration={row.seconds}", f"seed={seed}"]
    sets += [f"load_noise={{std: {noise}, time_constant: 1}}"] if noise else ["load_noise=null", "measurement.noise={}"]
    return sets + ([scenario(row.source, frequency(row), amplitude(row))] if row.source else [])


def scenario(source: str, hertz: float, relative: float) -> str:
    """One forced oscillation from 2 s on."""
    event = f"kind: forced_oscillation, {SOURCES[source]}, frequency: {hertz}, amplitude: {relative}"
    return f"scenario=[{{time: 2.0, {event}}}]"


@cache
def interarea(gain: float) -> tuple[float, float]:
    """Frequency (Hz) and damping ratio of the slowest electromechanical mode."""
    case = load_case("two_area_deployment", [*FREE, f"system.stabilisers.*.K={gain}"])
    modes = [mode for mode in modal_tables.analyse(case.system, case.run.devices).modes if mode.swings]
    slowest = min(modes, key=lambda mode: mode.frequency_hz)
    return slowest.frequency_hz, slowest.damping_ratio


def frequency(row: Row) -> float:
    """Frequency of a forced oscillation, Hz."""
    return DISTANCES[row.distance] * interarea(row.gain)[0] or FAR


@cache
def amplitude(row: Row) -> float:
    """Relative amplitude of a source of the size of a row, by a run in which it is alone, at its end."""
    alone = row._replace(source="", seconds=90.0, sets=FREE)
    record = loop.run(
        load_case("two_area_deployment", [*sets_of(alone, 0, 0.0), scenario(row.source, frequency(row), 1e-3)])
    )
    last = columns(speed_differences(record))[-10 * record.frame_rate :]
    return 1e-3 * row.mhz / (500.0 * float(np.ptp(last, axis=0).max()) * 60.0)


class Seen(NamedTuple):
    """A run of a row: its truth, noise, and what each side calls it."""

    truth: str
    noise: float
    called: dict[str, str]


def seen(task: tuple[str, int]) -> Seen:
    """Simulate and judge a run."""
    name, seed = task
    row, noise = rows()[name], NOISES[seed % 2]
    record = loop.run(load_case("two_area_deployment", sets_of(row, seed, noise)))
    verdict = summarise(record, method=None, twin=twin_of(record)).verdict
    last = max(event_times(record), default=0.0)
    alone = forced.origin(record.time_s, columns(speed_differences(record)), last).kind
    named = {FORCED: forced.FORCED, UNDECIDED: forced.UNDECIDED}
    return Seen(row.truth, noise, {"analyze": named.get(verdict, forced.NATURAL), "record_alone": alone})


def watched(task: tuple[str, int]) -> Seen:
    """Simulate a run with a supervisor: forced if the monitor acts at some time."""
    name, seed = task
    row, noise = watched_rows()[name], NOISES[seed % 2]
    built = loop.build_loop(case := load_case("two_area_deployment", sets_of(row, seed, noise)))
    record, threshold = loop.finish(case, built), built.control.supervisors.thresholds[0, CODES["forced"]]
    over = record.supervision["values"][:, CODES["forced"]] > threshold["limit"]
    lasts = int(threshold["lasts_ns"] * 1e-9 * record.frame_rate)
    acts = np.convolve(over, np.ones(lasts + 1)).max() > lasts
    return Seen(row.truth, noise, {"monitor": forced.FORCED if acts else forced.NATURAL})


def wilson(right: int, runs: int) -> str:
    """A share in % with its 95 % interval (Wilson)."""
    low, high = stats.binomtest(right, runs).proportion_ci(0.95, method="wilson")
    return f"{100 * right / runs:.1f} % ({100 * low:.1f} to {100 * high:.1f})"


def counts(kinds: list[str]) -> str:
    """Kinds by their number."""
    return ", ".join(f"{number} {kind}" for kind, number in Counter(kinds).most_common())


def main(first: int, seeds: int, names: list[str], out: Path, monitor: bool) -> None:
    """Print the table and the shares that are right; write the table as CSV."""
    table, judge, sides = (watched_rows(), watched, MONITOR) if monitor else (rows(), seen, SIDES)
    chosen = names or list(table)
    for gain in sorted({table[name].gain for name in chosen}):
        print(f"gain {gain:g}: {interarea(gain)[0]:.3f} Hz, {100 * interarea(gain)[1]:.2f} %", flush=True)
    runs, lines = list[Seen](), []
    with ProcessPoolExecutor(2) as pool:
        tasks = [(name, seed) for name in chosen for seed in range(first, first + seeds)]
        judged = pool.map(judge, tasks, chunksize=max(1, seeds // 2))
        for name in chosen:
            calls = list(islice(judged, seeds))
            words = [counts([call.called[side] for call in calls]) for side in sides]
            lines.append([name, table[name].truth, str(seeds), *words])
            print("  ".join(lines[-1]), flush=True)
            runs += calls
    out.mkdir(parents=True, exist_ok=True)
    file = out / ("forced_monitor.csv" if monitor else "forced.csv")
    file.write_text(as_csv(("row", "truth", "runs", *sides), lines), encoding="utf-8")
    print(f"\n| truth | noise | runs | {' | '.join(sides.values())} |\n|---|--:|--:|{'--:|' * len(sides)}")
    for truth in (forced.FORCED, forced.NATURAL):
        for noises in ((NOISES[0],), (NOISES[1],), NOISES):
            some = [run for run in runs if run.truth == truth and run.noise in noises]
            right = [sum(run.called[side] == truth for run in some) for side in sides]
            noise = " and ".join(f"{100 * noise:g}" for noise in noises)
            if some:
                print(f"| {truth} | {noise} % | {len(some)} | {' | '.join(wilson(n, len(some)) for n in right)} |")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", metavar="ROW", help="rows; default: all")
    parser.add_argument("--first", type=int, default=FIRST, help=f"first seed (default: {FIRST})")
    parser.add_argument("--seeds", type=int, default=SEEDS, help=f"seeds (default: {SEEDS})")
    parser.add_argument("--out", type=Path, default=Path("results/forced"), help="folder of forced.csv")
    parser.add_argument("--monitor", action="store_true", help="count what the supervisor's monitor says")
    arguments = parser.parse_args()
    main(arguments.first, arguments.seeds, arguments.rows, arguments.out, arguments.monitor)
