"""60 s at 60 frames/s paced by the clock: what is lost, what is late."""

from __future__ import annotations

import tempfile
from pathlib import Path

from facts_damping.analysis.latency import frames_lost
from facts_damping.case.loading import load_case
from facts_damping.nodes import graph
from facts_damping.recording.reader import load

SECONDS = 60.0


def main() -> None:
    """Print frames, losses and deadline misses."""
    with tempfile.TemporaryDirectory() as folder:
        case = load_case(None, [f"duration={SECONDS}", "link=delay_100ms"])
        outcome = graph.run(case, "realtime", Path(folder), lambda *_: None)
        record = load(outcome.recording)
    print(f"{len(record.time_ns)} of {case.ticks} ticks recorded in {outcome.wall_s:.1f} s of wall time")
    print(f"frames lost {frames_lost(record)}, messages lost {outcome.messages_lost}")
    print(f"deadline misses {outcome.deadline_misses}")
    for note in record.notes:
        print(note)


if __name__ == "__main__":
    main()
