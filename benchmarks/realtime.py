"""60 s at 60 frames/s paced by the clock: what is lost, what is late."""

from __future__ import annotations

import os
import tempfile
from contextlib import suppress
from pathlib import Path

import psutil

from facts_damping.analysis import releases
from facts_damping.analysis.latency import frames_lost
from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load

SECONDS = float(os.environ.get("REALTIME_S", "60"))
FRAMES = 30  # between two looks
RUNS = ("two_area_small", "two_area_deployment")


def main() -> None:
    """Print frames, losses and deadline misses."""
    for run in RUNS:
        spent: dict[int, float] = {}  # s of processor of each node, as last seen

        def look(done: int, _of: int, spent: dict[int, float] = spent) -> None:
            if done % FRAMES < 13:
                for child in psutil.Process().children(recursive=True):
                    with suppress(psutil.Error):
                        spent[child.pid] = sum(child.cpu_times()[:2])

        with tempfile.TemporaryDirectory() as folder:
            case = load_case(run, [f"duration={SECONDS}"])
            outcome = graph.run(case, "realtime", Path(folder), look)
            record = load(outcome.recording)
        print(f"{run}: {len(record.time_ns)} of {case.ticks} ticks recorded in {outcome.wall_s:.1f} s of wall time")
        print(f"  deadline misses {outcome.deadline_misses}, devices released {len(releases.releases(record))}")
        print(f"  frames lost {frames_lost(record)}, messages lost {outcome.messages_lost}")
        print(f"  {sum(spent.values()) / outcome.wall_s:.2f} of a core, start included")
        for note in record.notes:
            print(f"  {note}")


if __name__ == "__main__":
    main()
