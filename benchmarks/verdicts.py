"""Verdicts under noise, judged on cases that they were not made on: a table of confusion, and damping ratios.

Truth is the linear loop of the grid that remains: with controllers the sampled closed loop (`facts-damping margin`),
without them the modes (`facts-damping modes`). The rule, written before: of sound loops (lowest damping ratio at least
1 %) 95 % are called damped; of those that grow (faster than 0.05 1/s) 95 % are called growing, limit cycle or lost
synchronism; at most 10 % of either are undecided, in every row. After an event the damping ratio of the response and
that of the linear mode of its frequency differ by at most 0.5 percentage points where the linear one is below 10 %.
"""

from __future__ import annotations

import argparse
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from facts_damping.analysis.summary import summarise
from facts_damping.case.loading import load_case
from facts_damping.simulation import loop
from facts_damping.simulation.twins import twin_of
from facts_damping.small_signal import modal_tables
from facts_damping_studies.margins.delay_margin import oscillations
from facts_damping_studies.margins.linear_closed_loop import delayed_loop, eigen, link_delays, sampled
from facts_damping_studies.margins.unsupervised import unsupervised
from facts_damping_studies.pages import as_csv

SOUND, GROWS = 0.01, 0.05  # damping ratio; 1/s
WELL = 0.1  # damping ratio above which ringdowns are over too soon to be measured
SEEDS, FIRST = 20, 501  # number, and the first one
FEW = (0.001, 0.2, 0.4)  # s
MANY = (0.001, 0.1, 0.2, 0.3, 0.4)
BARE = ("supervision=null", "arm_at=null")
FREE = (*BARE, "controllers=[]")
OUT = ("system.lines.4.x=10", "system.lines.4.b=0")  # the line of the recommended run's own event, after it
COLUMNS = (
    "loop",
    "delay_ms",
    "linear_growth_per_s",
    "linear_lowest_damping_percent",
    "linear_strongest_damping_percent",
    "response_damping_percent",
    "verdicts",
    "verdicts_without_twin",
)
NONE, EARLY = (0.0,), (0.001, 0.1)  # s, delays
LOADS = "load_noise={std: 0.01, time_constant: 1}"


class Row(NamedTuple):
    """A loop: its run and fields, its delays (s), and the fields with which its linear loop is made."""

    run: str
    sets: tuple[str, ...]
    delays: tuple[float, ...] = FEW
    linear: tuple[str, ...] | None = None
    late: str | None = None  # stage of the link beside the delay


def pulse(machine: str) -> str:
    """A pulse of mechanical power for half a second; the grid stays."""
    step = f"kind: mechanical_power_step, machine: {machine}"
    return f"scenario=[{{time: 2.0, {step}, change: -0.1}}, {{time: 2.5, {step}, change: 0.0}}]"


def fault(line: str, seconds: float = 0.08) -> str:
    """A fault in the middle of a line, which stays."""
    begins = f"{{time: 2.0, kind: fault, line: {line}, location: 0.5}}"
    return f"scenario=[{begins}, {{time: {2 + seconds}, kind: clear, line: {line}}}]"


def two_area(*sets: str, gain: float = 10.0, **more: Any) -> Row:
    """The recommended run with the lead-lag of a gain, 40 s."""
    run_sets = ("duration=40", *BARE, "controllers.0.name=LLC", f"controllers.0.parameters.gain={gain}", *sets)
    return Row("two_area_deployment", run_sets, **more)


def smib(*sets: str, gain: float = 10.0, **more: Any) -> Row:
    """The infinite bus with the lead-lag of a gain, 40 s, all noise of the deployment."""
    signal = "speed" if "measurement=null" in sets else "frequency"
    llc = f"controllers=[{{name: LLC, signals: [{signal}], parameters: {{gain: {gain}}}}}]"
    return Row("lead_lag_smib", ("duration=40", LOADS, pulse("G1"), "measurement=p_class", llc, *sets), **more)


NETS = ("duration=40", LOADS, "measurement=p_class", fault("line_18_49", 0.05))


def nets(*sets: str, gain: float = -62.29, **more: Any) -> Row:
    """New England and New York with two lead-lags, 40 s, all noise of the deployment."""
    signals = ("controllers.0.signals=[frequency_4_5]", "controllers.1.signals=[frequency_nyps_nets]")
    return Row("nets_nyps_two_devices", (*NETS, *signals, f"controllers.0.parameters.gain={gain}", *sets), **more)


NEW_ENGLAND = ("duration=40", LOADS, "measurement=p_class", fault("line_4_14", 0.05))
ROWS: dict[str, Row] = {
    "two areas, pulse": two_area(pulse("G1"), delays=MANY),
    "two areas, fault": two_area(fault("line_1"), delays=MANY),
    "two areas, trip": two_area(delays=MANY, linear=OUT),
    "two areas, trip, LLC-tuned": Row("two_area_deployment", ("duration=40", *BARE), linear=OUT),
    "two areas, trip, no control": Row("two_area_deployment", (*FREE, "duration=40"), NONE, OUT),
    "two areas, fault, LLC-tuned": Row("two_area_deployment", ("duration=40", *BARE, fault("line_1")), MANY),
    "two areas, fault, wrong sign": two_area(fault("line_1"), gain=-20, delays=MANY),
    "two areas, fault, double gain": two_area(fault("line_1"), gain=20, delays=MANY),
    "two areas, fault, noise of PMUs": two_area(fault("line_1"), "load_noise=null"),
    "two areas, fault, noise of loads": two_area(fault("line_1"), "measurement.noise={}"),
    "two areas, fault, class M": two_area(fault("line_1"), "measurement=m_class"),
    "two areas, fault, no control": Row("two_area_deployment", (*FREE, "duration=40", fault("line_1")), NONE),
    "two areas, fault, slow growth": two_area(fault("line_1"), gain=-12, delays=(0.001, 0.05)),
    "two areas, no event": two_area("scenario=[]", "duration=120"),
    "two areas, no event, no control": Row("two_area_deployment", (*FREE, "duration=120", "scenario=[]"), NONE),
    "two areas, no event, wrong sign": two_area("scenario=[]", "duration=120", gain=-20, delays=(0.001, 0.1)),
    "two areas, no event, slow growth": two_area("scenario=[]", "duration=120", gain=-12, delays=(0.001, 0.05)),
    "two areas, pulse, growth from 20 s on": two_area(
        pulse("G1"),
        gain=20,
        delays=EARLY,
        linear=("controllers.0.parameters.gain=-20",),
        late="{model: scale, factor: -1, start: 20}",
    ),
    "two areas, pulse, growth from 25 s on": two_area(
        pulse("G1"),
        delays=EARLY,
        linear=("controllers.0.parameters.gain=-20",),
        late="{model: scale, factor: -2, start: 25}",
    ),
    "infinite bus": smib(),
    "infinite bus, wrong sign": smib(gain=-10),
    "infinite bus, large gain": smib(gain=60),
    "infinite bus, class M": smib("measurement=m_class"),
    "New England and New York": nets(),
    "New England and New York, wrong sign": nets(gain=62.29),
    "New England and New York, no control": Row("nets_nyps_two_devices", (*FREE, *NETS), NONE),
    "New England, no control": Row("new_england_39_fault", NEW_ENGLAND, NONE),
    "New England, exciters of large gain": Row("new_england_39_fault", (*NEW_ENGLAND, "system.exciters.*.KA=80"), NONE),
}


def sets_of(row: Row, delay: float, linear: bool = False) -> list[str]:
    """Fields of a row's run, or of its linear loop."""
    late = "" if row.late is None or linear else f", {row.late}"
    link = f"link={{up: [{{model: constant, delay: {delay}}}{late}], down: []}}"
    return [*row.sets, link, *((row.linear or ()) if linear else ())]


def truth(row: Row, delay: float) -> tuple[float, list[tuple[float, float]]]:
    """Growth rate (1/s) of the linear loop, and damping ratio and frequency (Hz) of its modes, the lowest first."""
    case = unsupervised(load_case(row.run, sets_of(row, delay, linear=True)))
    if case.controllers:
        delayed = delayed_loop(case)
        spectrum = eigen(delayed, sampled(delayed, min(link_delays(case))))
        growth, modes = spectrum.growth, oscillations(delayed, spectrum, case)
    else:
        modes = modal_tables.analyse(case.system, case.run.devices).modes
        growth = max(mode.eigenvalue.real for mode in modes if mode.swings)
    return growth, sorted((mode.damping_ratio, mode.frequency_hz) for mode in modes if mode.swings)


class Seen(NamedTuple):
    """A run: verdicts with and without twin, damping ratio and frequency (Hz) of the strongest mode."""

    name: str
    delay: float
    verdict: str
    alone: str
    mode: tuple[float, float] | None


def seen(task: tuple[str, float, int]) -> Seen:
    """Simulate and judge a run."""
    name, delay, seed = task
    row = ROWS[name]
    record = loop.run(load_case(row.run, [*sets_of(row, delay), f"seed={seed}"]))
    plain, summary = summarise(record, method=None), summarise(record, twin=twin_of(record))
    modes = [(mode.damping_ratio, mode.frequency_hz) for mode in summary.modes]
    return Seen(name, delay, summary.verdict, plain.verdict, modes[0] if modes else None)


def words(verdicts: list[str]) -> str:
    """Verdicts by their number."""
    return ", ".join(f"{count} {verdict}" for verdict, count in Counter(verdicts).most_common())


def is_right(kind: str, verdict: str) -> bool:
    """Whether a loop of this kind is called so."""
    return verdict == "damped" if kind == "sound" else verdict not in ("damped", "undecided")


def nearest(modes: list[tuple[float, float]], responses: list[Seen]) -> tuple[float, str, list[float]]:
    """Of the linear mode at the frequency of the responses' strongest modes: its ratio, theirs as text, errors."""
    fitted = [response.mode for response in responses if response.mode is not None]
    if not fitted:
        return modes[0][0], "-", []
    hertz = float(np.median([frequency for _, frequency in fitted]))
    linear = min(modes, key=lambda mode: abs(mode[1] - hertz))
    near = [ratio for ratio, frequency in fitted if abs(frequency - linear[1]) < 0.1 * linear[1]]
    if not near:
        return linear[0], "-", []
    text = f"{100 * np.median(near):.2f} [{100 * min(near):.2f}, {100 * max(near):.2f}]"
    return linear[0], text, [100 * abs(ratio - linear[0]) for ratio in near]


def main(first: int, names: list[str], out: Path) -> None:
    """Print both tables and write the first as CSV; `first`: seed; names: of ROWS, all without."""
    chosen = [(name, delay) for name in names or ROWS for delay in ROWS[name].delays]
    with ProcessPoolExecutor() as pool:
        responses = list(
            pool.map(seen, [(*row, seed) for row in chosen for seed in range(first, first + SEEDS)], chunksize=4)
        )
    counted: dict[str, list[Seen]] = {"sound": [], "grows": []}
    table, failed, errors = [], [], []
    for name, delay in chosen:
        of_row = [response for response in responses if (response.name, response.delay) == (name, delay)]
        growth, modes = truth(ROWS[name], delay)
        kind = "sound" if modes[0][0] >= SOUND and growth < 0 else "grows" if growth > GROWS else None
        if kind:
            counted[kind] += of_row
            rate = np.mean([is_right(kind, response.verdict) for response in of_row])
            failed += [(name, delay, rate)] if rate < 0.95 else []
        strongest, text, off = nearest(modes, of_row)
        if kind == "sound" and strongest < WELL and "no event" not in name:
            errors += off
        figures = [f"{1e3 * delay:.0f}", f"{growth:.3f}", f"{100 * modes[0][0]:.2f}", f"{100 * strongest:.2f}", text]
        table.append([name, *figures, words([x.verdict for x in of_row]), words([x.alone for x in of_row])])
        print("  ".join(table[-1]), flush=True)
    out.mkdir(parents=True, exist_ok=True)
    (out / "verdicts.csv").write_text(as_csv(COLUMNS, table), encoding="utf-8")
    print("\n| the linear loop | runs | called so | right | undecided | without twin |\n|---|--:|---|--:|--:|--:|")
    for kind, verdict in (("sound", "damped"), ("grows", "growing, limit cycle or lost")):
        of_kind = counted[kind]
        sides = (
            [is_right(kind, response.verdict) for response in of_kind],
            [response.verdict == "undecided" for response in of_kind],
            [is_right(kind, response.alone) for response in of_kind],
        )
        rates = [100 * np.mean(side) for side in sides] if of_kind else []
        print(f"| {kind} | {len(of_kind)} | {verdict} | {' | '.join(f'{rate:.1f} %' for rate in rates)} |")
    print(f"\nrows below 95 %: {failed or 'none'}")
    if errors:
        print(
            f"damping ratios: off by {np.median(errors):.2f} in the median, {np.percentile(errors, 95):.2f} in 95 %, ",
            end="",
        )
        print(
            f"{max(errors):.2f} at most, of {len(errors)}; within 0.5: {100 * np.mean(np.array(errors) <= 0.5):.1f} %"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seed", nargs="?", type=int, default=FIRST, help="the first of the seeds")
    parser.add_argument("rows", nargs="*", help="loops (all without)")
    parser.add_argument("--out", type=Path, default=Path("results/verdicts"), help="folder for verdicts.csv")
    asked = parser.parse_args()
    main(asked.seed, asked.rows, asked.out)
