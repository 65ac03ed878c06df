"""The page on faults at inverters: how many runs ended how, by source, by model, and below the SCR of the rule.

    python -m facts_damping_reproduction.inverter_faults.pages results/inverter_faults

writes `faults.md` and `faults.csv`, a line for each case.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.output.tables import table
from facts_damping.output.writing import write_whole
from facts_damping_reproduction.inverter_faults import cases, runs
from facts_damping_reproduction.templates import render
from facts_damping_studies.pages import as_csv

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from facts_damping_reproduction.inverter_faults.cases import Case
    from facts_damping_reproduction.inverter_faults.runs import Outcome

CASES = 200
BELOW = (0.6, 1.5)  # SCR of the second series
BELOW_SEED = cases.SEED + 1
FINER = 4  # steps in one, of the second run of a case
HOW = (runs.SETTLED, runs.MOVING, runs.LOW_VOLTAGE, runs.LOST, runs.REFUSED, runs.BROKEN)
TITLES = ("case", "source", "SCR", "models", "place", "impedance p.u.", "duration s", "after", "ends", "how",
          "without current s", "step: end p.u.", "step: mean p.u.")  # fmt: skip


def row(number: int, case: Case, result: Outcome) -> list[Any]:
    """A line of `faults.csv`; what a step of a quarter changes in voltages, at the end and on average."""
    finer = runs.outcome(case, step=1 / 480 / FINER) if len(result.voltages) else result
    many = min(len(result.voltages), len(finer.voltages))
    apart = np.abs(result.voltages[:many] - finer.voltages[:many]).max(axis=1) if many else np.zeros(1)
    drawn = [number, case.source, round(case.scr, 3), " ".join(case.models), case.place, round(case.impedance, 4)]
    ended = [result.how, result.text.splitlines()[0] if result.text else "", round(result.without, 4)]
    return [*drawn, round(case.seconds, 4), case.after, *ended, float(apart[-1]), float(apart.mean())]


def counted(pairs: Sequence[tuple[Case, Outcome]], titles: str, keys: Callable[[Case], Sequence[str]]) -> list[str]:
    """How runs ended, by what a case has."""
    groups = dict.fromkeys(key for case, _ in pairs for key in keys(case))
    lines = []
    for key in groups:
        of_group = [result for case, result in pairs if key in keys(case)]
        counts = Counter(result.how for result in of_group)
        without = sum(result.without > 0.0 for result in of_group)
        lines.append([key, len(of_group), *(counts[how] for how in HOW), without])
    return table([titles, "cases", *HOW, "without current for a time"], lines, 1, markdown=True)


def page(pairs: Sequence[tuple[Case, Outcome]], below: Sequence[tuple[Case, Outcome]], rows: list[list[Any]]) -> str:
    """The page, from the cases of the rule, those of a lower SCR, and the lines of the first."""
    still = [line for line in rows if line[8] == runs.SETTLED]
    tables = {
        "by_source": counted(pairs, "source", lambda case: [case.source]),
        "by_model": counted(pairs, "a case with", lambda case: case.models),
        "below": counted(below, "source", lambda case: [case.source]),
    }
    refusals = Counter(_reason(result.text) for _, result in (*pairs, *below) if result.how == runs.REFUSED)
    return render(
        "inverter_faults/faults.md",
        **{name: "\n".join(lines) for name, lines in tables.items()},
        cases=len(pairs),
        of_below=len(below),
        broken=sum(result.how == runs.BROKEN for _, result in (*pairs, *below)),
        refused="\n".join(table(["refused for", "cases"], refusals.most_common(), 1, markdown=True)),
        end=f"{max(line[-2] for line in still):.1e}",
        mean=f"{np.median([line[-1] for line in still]):.1e}",
        settled=len(still),
    )


def _reason(text: str) -> str:
    """A refusal in short: the power flow, or a model's limits."""
    if "power flow" in text:
        return "no solution of the power flow"
    return "limits at the start" if "at the start; allowed" in text else text.splitlines()[0]


def write(folder: Path, count: int = CASES) -> list[Path]:
    """Run all cases and write page and table."""
    pairs = [(case, runs.outcome(case)) for case in map(cases.case, range(count))]
    below = [(case, runs.outcome(case)) for case in (cases.case(n, BELOW_SEED, BELOW) for n in range(count // 2))]
    rows = [row(number, *pair) for number, pair in enumerate(pairs)]
    write_whole(folder / "faults.csv", as_csv(TITLES, rows))
    write_whole(folder / "faults.md", page(pairs, below, rows))
    return [folder / "faults.md", folder / "faults.csv"]


def main(arguments: Sequence[str]) -> None:
    """Write into the folder that is given."""
    folder = Path(arguments[0])
    folder.mkdir(parents=True, exist_ok=True)
    print(*(f"written: {path}" for path in write(folder)), sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
