"""The demonstration of `make demo`: a system without control, with a lead-lag, and with a much longer delay."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from facts_damping import interruption
from facts_damping.analysis.plotting.plots import plot_comparison
from facts_damping.analysis.summary_table import table
from facts_damping.case import loading
from facts_damping.cli.reporting import run_result
from facts_damping.errors import FactsDampingError, one_line
from facts_damping.nodes.launching import graph
from facts_damping.output.terminal import Progress, note, show
from facts_damping.recording import seal
from facts_damping_views.analysis.details import improvements
from facts_damping_views.report import ReportedRun, write_runs

RUN = "two_area_deployment"
EVENT = "a fault on a line of the tie at 2 s, cleared by the trip of that line"
CASES = {"no control": ["controllers=[]"], "lead-lag": [], "lead-lag, 250 ms more": ["link.up.1.delay=0.253"]}


def run_all(folder: Path) -> None:
    """Run the three graphs in lockstep; write the table, plots and report."""
    named, results = [], []
    for name, sets in CASES.items():
        case = loading.load_case(RUN, sets)
        place = folder / name.replace(",", "").replace(" ", "_")
        with Progress(name) as progress:
            outcome = graph.run(case, "lockstep", place, progress)
        record = seal(outcome.recording)
        named.append((name, record))
        results.append(run_result(record, recording=str(place / "recording")))
        show(f"{name}: {len(record.time_ns)} ticks, {outcome.messages_lost} messages lost, {outcome.recording}")
    show(f"\ntwo_area in the profile deployment: {EVENT}\n")
    show(table([(name, result.summary) for (name, _), result in zip(named, results, strict=True)]))
    show("")
    for path in plot_comparison(named, folder):
        show(f"plot: {path}")
    show(f"recordings: {folder}/*/recording")
    percents = improvements([result.summary for result in results], 0)
    runs = [
        ReportedRun(*pair, result.summary, result.recording or "-", percent)
        for pair, result, percent in zip(named, results, percents, strict=True)
    ]
    write_runs(folder / "report.html", runs)
    show(f"report, for a browser: {_newest(folder)}/report.html")
    show("watch a run and change it in a browser: .venv/bin/facts-damping cockpit two_area_deployment --supervised")


def _newest(folder: Path) -> Path:
    """Link `results/demo` to the newest folder; returns the folder if something else has that name."""
    link = folder.parent / "demo"
    if link.is_symlink():
        link.unlink()
    if link.exists():
        return folder
    link.symlink_to(folder.name)
    return link


def main() -> int:
    """Entry point of `python -m facts_damping_views.demo`."""
    folder = Path("results") / f"demo-{time.strftime('%Y%m%d-%H%M%S')}"
    with interruption.handled():
        try:
            run_all(folder)
        except FactsDampingError as error:
            note(f"demo: {one_line(error)}")
            return 1
        except KeyboardInterrupt:
            note(f"demo: {interruption.text()}")
            return interruption.status()
    return 0


if __name__ == "__main__":
    sys.exit(main())
