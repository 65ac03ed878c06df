"""Every neuro-fuzzy controller, scheme and scenario as a lockstep graph, compared bit for bit with the in-process run.

`python benchmarks/graphs.py [SECONDS]`: 220 graphs of a few processes each, three quarters of an hour on two cores:
MISO on all scenarios, MIMO on those of two_area. `--mimo` makes the latter alone. Says which differ, and exits with 1
if any does.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from facts_damping.case.loading import load_case
from facts_damping.neurofuzzy.table import VARIANTS
from facts_damping.nodes.launching import graph
from facts_damping.recording.reader import load
from facts_damping.simulation import loop
from facts_damping_studies.sweeps.enumerated_axes import scenarios

BOTH = ("devices=[sssc, statcom]", "controllers=[{signals: [speed, power], devices: [sssc, statcom]}]")
ARRAYS = (
    *("time_ns", "frames", "delivered", "issued", "applied", "machines"),
    *("devices", "in_synchronism", "estimates", "learning"),
)


def differing(sets: list[str], folder: Path) -> list[str]:
    """Names of the arrays in which a graph's recording differs from the in-process run."""
    case = load_case(None, sets)
    graph.run(case, "lockstep", folder, lambda _done, _of: None, timeout=20.0)
    recorded, computed = load(folder / "recording"), loop.run(case)
    return [name for name in ARRAYS if getattr(recorded, name).tobytes() != getattr(computed, name).tobytes()]


def runs(mimo_only: bool) -> list[tuple[str, list[str]]]:
    """Label and changes of every graph."""
    graphs = []
    for system in ("two_area", "smib"):
        for scenario in scenarios(system):
            for name in VARIANTS:
                for scheme in ("direct", "indirect"):
                    place = [f"system={system}", f"scenario={scenario}"]
                    controller_sets = [f"controllers.0.name={name}", f"controllers.0.scheme={scheme}"]
                    if not mimo_only:
                        graphs.append((f"{system} {scenario} {name} {scheme}", [*place, *controller_sets]))
                    if system == "two_area":
                        graphs.append((f"{system} {scenario} {name} {scheme} MIMO", [*place, *BOTH, *controller_sets]))
    return graphs


def main() -> int:
    """All of them, one after the other."""
    words = [word for word in sys.argv[1:] if word != "--mimo"]
    more = [f"duration={float(words[0])}"] if words else []
    began, bad = time.monotonic(), 0
    asked = runs("--mimo" in sys.argv)
    for label, sets in asked:
        with tempfile.TemporaryDirectory() as folder:
            differences = differing([*sets, *more], Path(folder))
        bad += bool(differences)
        print(f"{label}: {', '.join(differences) or 'identical'}", flush=True)
    print(f"{len(asked)} graphs, {bad} differ, {time.monotonic() - began:.0f} s")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
