"""Makes the traces of `config/references/psse` from the benchmarks of PowerSimulationsDynamics.jl.

    python tests/data/make_psse_traces.py FOLDER    # test/benchmarks/psse of its repository

Of each trace the columns that `cases.yaml` names, every tenth sample and all of those around the event. PSS/E counts its
time in single precision: it is rounded to steps. Of two samples at the switching time the second is kept.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from facts_damping_validation.psse import Case, cases, folder

EVERY, BEFORE, AFTER = 10, 5, 40  # samples; the last two: around the event


def samples(path: Path) -> np.ndarray:
    """The rows of a trace without its head, the last of those at the same time."""
    rows = []
    for row in csv.reader(path.read_text(encoding="utf-8").splitlines()):
        try:
            rows.append([float(cell) for cell in row if cell.strip()])
        except ValueError:
            continue
    table = np.array([row for row in rows if len(row) == max(map(len, rows))])
    rate = round(1.0 / float(np.median(np.diff(table[:, 0]))))
    table[:, 0] = np.round(table[:, 0] * rate) / rate
    return table[np.append(np.diff(table[:, 0]) > 1e-6, True) & (table[:, 0] > -1e-6)]


def thinned(case: Case, table: np.ndarray) -> list[list[str]]:
    """The rows of the shipped file."""
    event = int(np.searchsorted(table[:, 0], case.at - 1e-6))
    kept = [i for i in range(len(table)) if i % EVERY == 0 or event - BEFORE <= i <= event + AFTER]
    head = ["t", *(f"{c.quantity} {c.element}" for c in case.columns)]
    rows = [[table[i, 0], *(table[i, c.number - 1] - c.unit.zero for c in case.columns)] for i in kept]
    return [head, *([f"{t:.7g}", *(f"{value:.7g}" for value in values)] for t, *values in rows)]


def main(source: Path) -> None:
    """Write the traces."""
    for case in cases():
        path = source / case.folder / case.trace
        with (folder() / case.folder / case.trace).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(thinned(case, samples(path)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
