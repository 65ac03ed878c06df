"""60 s at 60 frames/s paced by the clock: what is lost, what is late."""

from __future__ import annotations

import os
import resource
import tempfile
from pathlib import Path

from facts_damping.analysis import releases
from facts_damping.analysis.latency import frames_lost
from facts_damping.case.loading import load_case
from facts_damping.nodes import graph
from facts_damping.recording.reader import load

SECONDS = float(os.environ.get("REALTIME_S", "60"))
RUNS = ("two_area_small", "two_area_deployment")


def main() -> None:
    """Print frames, losses and deadline misses."""
    for run in RUNS:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        with tempfile.TemporaryDirectory() as folder:
            case = load_case(run, [f"duration={SECONDS}"])
            outcome = graph.run(case, "realtime", Path(folder), lambda *_: None)
            record = load(outcome.recording)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"{run}: {len(record.time_ns)} of {case.ticks} ticks recorded in {outcome.wall_s:.1f} s of wall time")
        print(f"  deadline misses {outcome.deadline_misses}, devices released {len(releases.releases(record))}")
        print(f"  frames lost {frames_lost(record)}, messages lost {outcome.messages_lost}")
        print(f"  {spent / outcome.wall_s:.2f} of a core")
        for note in record.notes:
            print(f"  {note}")


if __name__ == "__main__":
    main()
