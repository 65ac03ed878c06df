"""Which kinds of a set of cases stand beside its score: the rule of `statistics.discriminates` on another draw.

python benchmarks/score_kinds.py two_area_2.0 minniwecc_2.0
"""

from __future__ import annotations

import os
import sys

import numpy as np

from facts_damping.output.terminal import Progress
from facts_damping_studies.score.card import logs
from facts_damping_studies.score.cases.sets import drawn_again, read_set
from facts_damping_studies.score.entries import NONE, measured_entries
from facts_damping_studies.score.statistics import discriminates


def main(*names: str) -> None:
    """Print a table for each set."""
    jobs = os.cpu_count() or 1
    for name in names:
        case_set = read_set(name)
        with Progress(name, "cases drawn") as progress:
            training = drawn_again(case_set, f"{case_set.content.seed} training", "training", jobs, progress)
        with Progress(name, "cases") as progress:
            entries = measured_entries(training, {NONE: (), **case_set.content.controllers}, jobs, progress)
        none = entries.pop(NONE).cases
        ratios = np.array([logs(entry.cases, none) for entry in entries.values()])
        print(f"\n| {name} | {' | '.join(entries)} | in the score |\n|{'---|' * (len(entries) + 2)}")
        for kind in case_set.content.kinds:
            at = [i for i, case in enumerate(training.cases) if case.kind == kind]
            events = [training.cases[i].event for i in at]
            tells, why = discriminates(ratios[:, at], events)
            changes = " | ".join(f"{100.0 * np.expm1(mean):+.0f} %" for mean in ratios[:, at].mean(axis=1))
            print(f"| {kind} | {changes} | {'yes' if tells else why} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
