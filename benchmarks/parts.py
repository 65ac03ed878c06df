"""Where the time of a loop goes: shares of compiled functions, by sampling the processor with Linux's `perf`.

`python benchmarks/parts.py [RUN ...]`: two areas, 68, 122 and 240 buses. A function has in it what the compiler has put
in line.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from bisect import bisect_right
from collections import Counter
from pathlib import Path

from facts_damping.case.loading import load_case
from facts_damping.compiling import store
from facts_damping.simulation.loop import build_loop, run_loop

RUNS = ("two_area_small", "two_area_deployment", "nets_nyps_two_devices", "minniwecc", "wecc_240")
TIMES, RATE, LEAST = 10, 4000, 0.01  # runs, samples/s, smallest share shown
OURS = ("anon", "unknown", "perf-")  # where compiled functions are, in the words of perf


def loop(run: str, addresses: Path) -> None:
    """Run a loop several times, and write where its compiled functions are."""
    case = load_case(run)
    for _ in range(TIMES):
        run_loop(build_loop(case))
    addresses.write_text(json.dumps(store._addresses))  # noqa: SLF001 (nobody else asks)


def shares(run: str) -> Counter[str]:
    """Samples by function of a run."""
    with tempfile.TemporaryDirectory() as folder:
        data, addresses = Path(folder, "perf.data"), Path(folder, "addresses.json")
        child = [sys.executable, __file__, "--loop", run, str(addresses)]
        record = ["perf", "record", "-q", "-e", "cpu-clock", "-F", str(RATE), "-o", str(data), *child]
        subprocess.run(record, check=True)
        script = ["perf", "script", "-i", str(data), "-F", "ip,dso"]
        lines = subprocess.run(script, check=True, capture_output=True, text=True).stdout.splitlines()
        starts = sorted((at, symbol) for symbol, at in json.loads(addresses.read_text()).items())
    counts: Counter[str] = Counter()
    for line in lines:
        at, _, where = line.strip().partition(" ")
        place = bisect_right(starts, (int(at, 16), "~")) - 1
        if place >= 0 and any(part in where for part in OURS):
            counts[starts[place][1].removeprefix("facts_damping.")] += 1
    return counts


def main() -> None:
    """Print the shares of each run."""
    if sys.argv[1:2] == ["--loop"]:
        loop(sys.argv[2], Path(sys.argv[3]))
        return
    for run in sys.argv[1:] or RUNS:
        counts = shares(run)
        total = sum(counts.values())
        print(f"{run}: {1e3 * total / RATE / TIMES:.1f} ms of compiled functions a run")
        for name, count in counts.most_common():
            if count >= LEAST * total:
                print(f"  {100 * count / total:5.1f} %  {name}")


if __name__ == "__main__":
    main()
