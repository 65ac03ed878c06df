"""Makes the traces of `config/references/psse` from the benchmarks of PowerSimulationsDynamics.jl.

    python tests/data/make_psse_traces.py FOLDER    # test/benchmarks/psse of its repository

Of each trace the columns that `cases.yaml` names, every tenth sample and all of those around the event. PSS/E counts
its time in single precision: it is rounded to steps. Of two samples at the switching time the second is kept, which is
after the event; a single one is before it, and left out.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from facts_damping_validation.psse import Case, cases, folder

EVERY, BEFORE, AFTER = 10, 5, 40  # samples; the last two: around the event


def samples(path: Path, at: float) -> np.ndarray:
    """The rows of a trace without its head; of the switching time `at` (s) the second one, none if there is one."""
    rows = []
    for row in csv.reader(path.read_text(encoding="utf-8").splitlines()):
        try:
            rows.append([float(cell) for cell in row if cell.strip()])
        except ValueError:
            continue
    table = np.array([row for row in rows if len(row) == max(map(len, rows))])
    rate = round(1.0 / float(np.median(np.diff(table[:, 0]))))
    table[:, 0] = np.round(table[:, 0] * rate) / rate
    switching = np.flatnonzero(np.abs(table[:, 0] - at) < 1e-6)
    assert len(switching) in (1, 2)
    return np.delete(table, [switching[0], *np.flatnonzero(table[:, 0] < -1e-6)], axis=0)


def thinned(case: Case, table: np.ndarray) -> list[list[str]]:
    """The rows of the shipped file."""
    event = int(np.searchsorted(table[:, 0], case.at - 1e-6))
    shown = [i for i in range(len(table)) if i % EVERY == 0 or event - BEFORE <= i <= event + AFTER]
    head = ["t", *(f"{c.quantity} {c.element}" for c in case.columns)]
    rows = [[table[i, 0], *(table[i, c.number - 1] - c.unit.zero for c in case.columns)] for i in shown]
    return [head, *([f"{t:.7g}", *(f"{value:.7g}" for value in values)] for t, *values in rows)]


def main(source: Path) -> None:
    """Write the traces."""
    for case in cases():
        path = source / case.folder / case.trace
        with (folder() / case.folder / case.trace).open("w", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(thinned(case, samples(path, case.at)))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
