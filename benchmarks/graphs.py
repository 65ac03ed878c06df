"""Every neuro-fuzzy controller, scheme and scenario as a lockstep graph, compared bit for bit with the in-process run.

`python benchmarks/graphs.py [SECONDS]`: 154 graphs of a few processes each, half an hour on two cores. Says which
differ, and exits with 1 if any does.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from facts_damping import graph, loop
from facts_damping.configuration import load_case
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.recording.reader import load
from facts_damping.studies.compare import SYSTEMS, scenarios

ARRAYS = (
    *("time_ns", "frames", "delivered", "issued", "applied", "machines"),
    *("devices", "in_synchronism", "estimates"),
)


def differing(sets: list[str], folder: Path) -> list[str]:
    """Names of the arrays in which a graph's recording differs from the in-process run."""
    case = load_case(None, sets)
    graph.run(case, "lockstep", folder, lambda _done, _of: None, timeout=20.0)
    recorded, computed = load(folder / "recording"), loop.run(case)
    return [name for name in ARRAYS if getattr(recorded, name).tobytes() != getattr(computed, name).tobytes()]


def main() -> int:
    """All of them, one after the other."""
    more = [f"duration={float(sys.argv[1])}"] if len(sys.argv) > 1 else []
    began, count, bad = time.monotonic(), 0, 0
    for system in SYSTEMS:
        for scenario in scenarios(system):
            for name in VARIANTS:
                for scheme in ("direct", "indirect"):
                    own = [f"controllers.0.name={name}", f"controllers.0.scheme={scheme}"]
                    with tempfile.TemporaryDirectory() as folder:
                        found = differing([f"system={system}", f"scenario={scenario}", *own, *more], Path(folder))
                    count, bad = count + 1, bad + bool(found)
                    print(f"{system} {scenario} {name} {scheme}: {', '.join(found) or 'identical'}", flush=True)
    print(f"{count} graphs, {bad} differ, {time.monotonic() - began:.0f} s")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
