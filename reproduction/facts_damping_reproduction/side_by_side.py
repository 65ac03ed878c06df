"""The tables side by side in Markdown: theirs, ours, ours over the ensemble; orders; contradictions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from facts_damping.analysis.convergence import MARK
from facts_damping.output import tables
from facts_damping_reproduction.agreement import ComparedRun, compare, markdown, name
from facts_damping_reproduction.ensembles import drawn, median
from facts_damping_reproduction.operations import WHY
from facts_damping_reproduction.operations import markdown as operations
from facts_damping_reproduction.printed import LLC, ROUGHNESS
from facts_damping_reproduction.results import OPERATIONS, TITLES
from facts_damping_reproduction.runs import BOUND, TUNED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_reproduction.agreement import Compared
    from facts_damping_reproduction.findings import Findings
    from facts_damping_reproduction.printed import Cell, ControllerId
    from facts_damping_reproduction.results import Results

HEAD = """# The tables, side by side

Made by `{command}`. In each cell: theirs; ours; ours less theirs; the median of ours over the ensemble with its 95 %
interval. Improvements (4.109) in %, roughness (5.34) in p.u./s². `*`: the thesis contradicts itself; its printed
figure stands struck through before the reading that fits. `-`: no figure, the run lost synchronism. `~`: half the
integration step changes the figure by more than 1 %; such runs have no place in the orders. Beside the thesis's
references, LLC and direct ANFTSC, are two that it does not have, the tuned lead-lag and the bound: ours; ours over the
ensemble."""

BESIDE = (TUNED, BOUND)
ORDER = ("rho", "p", "best", "best_ours", "second", "second_ours", "far")
STATED = ("scenario", "controller", "scheme", "what", "over", "quantity")


def page(results: Results, findings: Findings, command: str) -> list[str]:
    """All tables that were asked for."""
    lines = [*HEAD.format(command=command).splitlines(), ""]
    for table in results.tables:
        lines += [f"## Table {table}. {TITLES[table]}", ""]
        lines += _operations(results) if table == OPERATIONS else _table(table, results, findings)
    return lines


def _operations(results: Results) -> list[str]:
    reasons = [f"- `{controller}`: {why}" for controller, why in WHY.items()]
    head = "Theirs / ours / ours with all derivatives of a step (docs/neuro_fuzzy.md):"
    return [head, "", *operations(results.complexity), "", "Where they differ:", "", *reasons, ""]


def _table(table: str, results: Results, findings: Findings) -> list[str]:
    compared = [c for c in findings.plain.compared if c.cell.table == table]
    lines = [f"![Table {table}: theirs against ours](table_{table.replace('.', '_')}.png)", ""]
    for scenario in dict.fromkeys(c.cell.scenario for c in compared):
        scenario_rows = [c for c in compared if c.cell.scenario == scenario]
        lines += [f"### {scenario_rows[0].cell.system}, {scenario}", ""]
        for against in dict.fromkeys(c.cell.against for c in scenario_rows):
            reference_rows = [c for c in scenario_rows if c.cell.against == against]
            over = f"Improvement over {name(against)}:" if against else "Roughness:"
            lines += [over, "", *_cells(reference_rows, results), ""]
        if scenario_rows[0].cell.against is None:
            lines += [_smooth_beside(scenario_rows, results), ""]
        for against in BESIDE if scenario_rows[0].cell.against else ():
            reference_rows = [c for c in scenario_rows if c.cell.against == LLC]
            lines += [f"Improvement over {name(against)}:", "", *_beside(reference_rows, against, results), ""]
        rankings = [r for r in findings.plain.rankings if (r.table, r.scenario) == (table, scenario)]
        lines += ["Orders:", "", *markdown(rankings, ["quantity", "scheme"], ORDER, ".2f"), ""]
    broken = [s for s in findings.plain.statements if s.table == table and not s.agrees]
    lines += [
        f"Contradictions: {len(broken)} of {sum(s.table == table for s in findings.plain.statements)} statements.",
        "",
    ]
    return [*lines, *(markdown(broken, STATED, ["theirs", "ours"]) if broken else []), ""]


def _cells(comparisons: Sequence[Compared], results: Results) -> list[str]:
    """A row a controller, a column a quantity (of roughness an architecture and scheme)."""
    smooth = comparisons[0].cell.against is None
    columns = list(dict.fromkeys(_column(c, smooth=smooth) for c in comparisons))
    rows = dict.fromkeys(c.cell.controller for c in comparisons)
    at = {(c.cell.controller, _column(c, smooth=smooth)): c for c in comparisons}
    table_rows = [
        [
            controller,
            *(_cell(at[controller, column], results) if (controller, column) in at else "" for column in columns),
        ]
        for controller in rows
    ]
    return tables.table(["controller", *columns], table_rows, markdown=True)


def _beside(comparisons: Sequence[Compared], against: ControllerId, results: Results) -> list[str]:
    """A row a controller, a column an index: improvement over a reference that the thesis does not have."""
    columns = list(dict.fromkeys(c.cell.quantity for c in comparisons))
    rows: dict[str, list[str]] = {}
    for c in comparisons:
        other = c.cell._replace(against=against)
        ours = compare([other], results.figures)[0].ours
        figure_text = "-" if ours is None else f"{ours:.4g}"
        rows.setdefault(c.cell.controller, []).append(f"{figure_text}; {_median(other, results)}")
    return tables.table(["controller", *columns], [[who, *cells] for who, cells in rows.items()], markdown=True)


def _smooth_beside(comparisons: Sequence[Compared], results: Results) -> str:
    """The roughness of the controllers that the thesis does not have, of the architectures in a table."""
    (system, scenario), architectures = (
        comparisons[0].cell[1:3],
        dict.fromkeys(c.cell.architecture for c in comparisons),
    )
    whos = [who._replace(architecture=architecture) for architecture in architectures for who in BESIDE]
    by_name = {name(who): results.figures[ComparedRun(system, scenario, who)] for who in whos}
    texts = [
        f"{who} {'-' if figures is None else format(figures[ROUGHNESS], '.4g')}" for who, figures in by_name.items()
    ]
    return f"Ours alone: {', '.join(texts)}."


def _column(c: Compared, *, smooth: bool) -> str:
    return " ".join(filter(None, (c.cell.architecture, c.cell.scheme))) if smooth else c.cell.quantity


def _cell(c: Compared, results: Results) -> str:
    printed = f"{c.cell.corrected:g}"
    if c.cell.reason:
        printed = f"~~{c.cell.printed:g}~~ {printed}\\*"
    ours = "-; -" if c.ours is None or c.difference is None else f"{c.ours:.4g}; {c.difference:+.4g}"
    if c.ours is not None and not c.converged:
        ours = f"{MARK}{c.ours:.1g}; {MARK}"
    return f"{printed}; {ours}; {_median(c.cell, results)}"


def _median(cell: Cell, results: Results) -> str:
    """Median over the ensemble, and its interval."""
    middle, low, high = median(drawn(cell, results.ensembles)[1])
    return f"{_number(middle)} ({_number(low)} to {_number(high)})"


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "-"
