"""How long `design` takes to rank the places of new devices and signals in a grid of 1,952 buses, and its parts.

    python benchmarks/ranking.py [COPIES]

The grid is of 16 copies of minniwecc, `many_areas` of `scaling.py`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import yaml
from scaling import many_areas

from facts_damping_studies.design import design

if TYPE_CHECKING:
    from collections.abc import Callable


def told(study: str, what: str) -> Callable[[int, int], None]:
    """Show the progress of a part in a line."""
    start = time.perf_counter()

    def progress(done: int, of: int) -> None:
        sys.stderr.write(f"\r{study}: {what} {done} of {of}, {time.perf_counter() - start:.1f} s ")

    return progress


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 16
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "copies.yaml"
        path.write_text(yaml.safe_dump(many_areas(count)), encoding="utf-8")
        clock, processor = time.perf_counter(), time.process_time()
        ranking = design.ranked(design.Task(str(path), [], 0.1, 0.1), 1, told)
        seconds = time.perf_counter() - clock, time.process_time() - processor
    places, buses = len(ranking.tried), len(ranking.bare.buses)
    print(f"\n{buses} buses, {places} places, {len(ranking.system.signals)} signals: {seconds[0]:.1f} s")
    print(f"of one processor: {seconds[1]:.1f} s")
    for pair in ranking.pairs:
        print(ranking.tried[pair.tried].place.label, pair.signal, f"{abs(pair.residue):.4g} 1/s")
