"""The main job, as `make demo` runs it: no control, lead-lag control, and the same with 100 ms of delay."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from facts_damping import commands, configuration, graph
from facts_damping.analysis.summary import table
from facts_damping.errors import FactsDampingError
from facts_damping.recording.reader import load
from facts_damping.terminal import Progress

CASES = {
    "no control": ["controllers=[]"],
    "LLC": [],
    "LLC, 100 ms": ["link=delay_100ms"],
}


def run_all(folder: Path) -> None:
    """Run the three graphs in lockstep, put their figures side by side, plot them together."""
    named = []
    for name, sets in CASES.items():
        case = configuration.load_case("two_area_small", sets)
        place = folder / name.replace(",", "").replace(" ", "_")
        progress = Progress(name)
        try:
            outcome = graph.run(case, "lockstep", place, progress)
        finally:
            progress.close()
        record = load(outcome.recording)
        named.append((name, record))
        print(f"{name}: {len(record.time_ns)} ticks, {outcome.messages_lost} messages lost, {outcome.recording}")
    print("\nscenario small of two_area: load of area 2 decreased by 10 % at t = 1 s\n")
    print(table([(name, commands.summarise(record, None, None)) for name, record in named]))
    print()
    for path in commands.plot(named, folder):
        print(f"plot: {path}")
    print(f"recordings: {folder}/*/recording")


def main() -> int:
    """Entry point of `python -m facts_damping.demo`."""
    folder = Path("results") / f"demo-{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        run_all(folder)
    except FactsDampingError as error:
        sys.stderr.write(f"demo: {error}\n")
        return 1
    except KeyboardInterrupt:
        sys.stderr.write("demo: interrupted\n")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
