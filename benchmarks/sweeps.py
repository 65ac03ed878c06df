"""Where a run of a sweep spends its time, and what sharing, processes and threads give.

    python benchmarks/sweeps.py

Runs of LLC on two_area, `small`, 20 s, as in config/studies/monte_carlo.yaml, and of `two_area_deployment`, which with
its noise needs a second run for the verdict. Ratios of one run count.
"""

from __future__ import annotations

import os
import statistics
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from joblib import Parallel, delayed
from threadpoolctl import threadpool_limits

from facts_damping.analysis.measures import columns, speed_differences
from facts_damping.analysis.modes.oscillation import settling_time
from facts_damping.analysis.modes.ringdown import ringdown_modes
from facts_damping.analysis.summary import summarise
from facts_damping.analysis.verdict import judge
from facts_damping.case.loading import load_case
from facts_damping.output.terminal import Progress
from facts_damping.parameters.field_errors import check
from facts_damping.simulation import loop
from facts_damping_studies.parameters import Study
from facts_damping_studies.sweeps import batch, sweep
from facts_damping_studies.sweeps.pool import workers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

RUNS = 15
MANY = 400
JOBS = os.cpu_count() or 1
STUDY = "monte_carlo"
DEPLOYMENT = {
    "run": "two_area_deployment",
    "sweep": [
        {
            "draws": {
                "number": 100,
                "variables": [
                    {"name": name, "field": field, "distribution": "uniform", "low": low, "high": high}
                    for name, field, low, high in (
                        ("delay_s", "link.up.1.delay", 0.0, 0.2),
                        ("noise", "load_noise.std", 0.005, 0.015),
                    )
                ],
            }
        }
    ],
}


def median_ms(function: Callable[[], object]) -> float:
    """Median wall time of a few calls, after one that is not counted, ms."""
    times = []
    for _ in range(RUNS + 1):
        began = time.perf_counter()
        function()
        times.append(time.perf_counter() - began)
    return 1e3 * statistics.median(times[1:])


def parts_of_a_run(plan: sweep.SweepPlan) -> None:
    """Print what the parts of one run take."""
    task = sweep._tasks(plan, {})[0]  # noqa: SLF001 (a run as the sweep makes it)
    case = batch.make(plan.base, task.changes)
    record = loop.run(case)
    t, signals = record.time_s, columns(speed_differences(record))
    sets = [f"{path}={value}" for path, value in task.changes.items()]
    rows: dict[str, Callable[[], Any]] = {
        "a run as `simulate` makes it": lambda: summarise(loop.run(load_case("two_area_small", sets))),
        "a run of a sweep": lambda: batch.one_run(plan.base, task),
        "  case": lambda: batch.make(plan.base, task.changes),
        "  closed loop": lambda: loop.run(case),
        "  figures": lambda: batch.figures(record, summarise(record)),
        "    modes": lambda: ringdown_modes(t, signals, 1.0),
        "    verdict": lambda: judge(t, signals, 1.0),
        "    settling time": lambda: settling_time(t, signals, 1.0),
    }
    print(f"{'one run, median of ' + str(RUNS):<45} {'ms':>8} {'fraction':>7}")
    took = {name: median_ms(function) for name, function in rows.items()}
    for name, seconds in took.items():
        print(f"{name:<45} {seconds:8.2f} {seconds / took['a run of a sweep']:7.2f}")


def many(plan: sweep.SweepPlan) -> None:
    """Print the time of many runs, one after the other, in threads, in processes."""
    tasks = sweep._tasks(plan, {})[:MANY]  # noqa: SLF001
    name = f"{len(tasks)} runs of {plan.study.run}"
    function = partial(batch.one_run, plan.base)

    def threads(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterable[Any]:
        parallel = Parallel(n_jobs=JOBS, backend="threading", return_as="generator_unordered")
        results: Iterable[Any] = parallel(delayed(function)(task) for task in tasks)
        return results

    print(f"\n{name:<45} {'s':>8} {'ratio':>7} {'10,000 runs, min':>17}")
    first = 0.0
    with workers(1) as alone, workers(JOBS) as processes:
        for name, each in (
            ("one after the other", alone),
            (f"{JOBS} threads", threads),
            (f"{JOBS} processes", processes),
        ):
            for _ in each(function, tasks[: 4 * JOBS]):
                pass  # processes start, plants are built
            began = time.perf_counter()
            failed = [row.error for _, row in each(function, tasks) if row.error]
            if failed:
                raise SystemExit(failed[0])
            took = time.perf_counter() - began
            first = first or took
            print(f"{name:<45} {took:8.2f} {first / took:7.2f} {took * 10_000 / len(tasks) / 60:17.1f}")


def main() -> None:
    """All parts."""
    plan = sweep.plan(STUDY, [])
    with threadpool_limits(1):  # as in a sweep
        parts_of_a_run(plan)
        many(plan)
        many(sweep.planned(check(Study, DEPLOYMENT, "deployment"), "deployment", "deployment", ""))
    with TemporaryDirectory() as folder:
        short = plan._replace(points=plan.points[:MANY])
        began = time.perf_counter()
        sweep.run(short, Path(folder), JOBS, None, Progress(STUDY, "runs"))
        print(f"{'the same, with journal and start':<45} {time.perf_counter() - began:8.2f}")


if __name__ == "__main__":
    main()
