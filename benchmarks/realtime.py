"""60 s at 60 frames/s paced by the clock: what is lost, what is late, and where a tick's time goes.

`python benchmarks/realtime.py [RUN ...]`; REALTIME_S: another duration, s.
"""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from facts_damping.analysis import releases
from facts_damping.analysis.latency import frames_lost
from facts_damping.case.loading import load_case
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load

if TYPE_CHECKING:
    from collections.abc import Mapping

    from facts_damping.nodes.launching.processes import Process

SECONDS = float(os.environ.get("REALTIME_S", "60"))
FRAMES = 30  # between two looks
RUNS = ("two_area_small", "two_area_deployment")


class Usage:
    """Seconds of processor of each node, at its first tick and as last seen, and the machine's load."""

    def __init__(self) -> None:
        self.first: dict[str, float] = {}
        self.last: dict[str, float] = {}
        self.loads: list[float] = []  # processes that run or wait, mean of a minute
        self.looked = 0

    def look(self, tick: int, nodes: Mapping[str, Process]) -> None:
        """Note what the nodes have used at a tick."""
        if tick < self.looked + FRAMES:
            return
        self.looked = tick
        self.loads.append(os.getloadavg()[0])
        for name, node in nodes.items():
            with suppress(psutil.Error):
                self.last[name] = sum(psutil.Process(node.process.pid).cpu_times()[:2])
                self.first.setdefault(name, self.last[name])

    def lines(self) -> list[str]:
        """Processor that a tick takes by node, from the first look on, and loads."""
        ticks = max(1, self.looked - FRAMES)
        took = {name: 1e3 * (seconds - self.first[name]) / ticks for name, seconds in self.last.items()}
        most = sorted(took.items(), key=lambda pair: -pair[1])
        parts = ", ".join(f"{name} {ms:.2f}" for name, ms in most)
        mean, largest = sum(self.loads) / len(self.loads), max(self.loads)
        return [
            f"ms of processor a tick: {parts}; all {sum(took.values()):.2f}",
            f"load {mean:.1f}, at most {largest:.1f}",
        ]


def main() -> None:
    """Print frames, losses and deadline misses."""
    for run in sys.argv[1:] or RUNS:
        usage = Usage()
        with tempfile.TemporaryDirectory() as folder:
            case = load_case(run, [f"duration={SECONDS}"])
            outcome = graph.run(case, "realtime", Path(folder), lambda *_: None, look=usage.look)
            record = load(outcome.recording)
        print(f"{run}: {len(record.time_ns)} of {case.ticks} ticks recorded in {outcome.wall_s:.1f} s of wall time")
        print(f"  deadline misses {outcome.deadline_misses}, devices released {len(releases.releases(record))}")
        print(f"  frames lost {frames_lost(record)}, messages lost {outcome.messages_lost}")
        for line in (*usage.lines(), *record.notes):
            print(f"  {line}")


if __name__ == "__main__":
    main()
