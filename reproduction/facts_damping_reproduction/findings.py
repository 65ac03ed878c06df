"""What follows from the runs: agreement, orders, how firm they are, what is reached of what can be."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from facts_damping.analysis.indices import THESIS_INDICES
from facts_damping_reproduction import agreement, ensembles, ranking
from facts_damping_reproduction.agreement import name
from facts_damping_reproduction.printed import LLC
from facts_damping_reproduction.results import LINK
from facts_damping_reproduction.runs import NOBODY, reached

if TYPE_CHECKING:
    from facts_damping_reproduction.agreement import Compared, Signs, Statement
    from facts_damping_reproduction.ensembles import Decided, Firmness, Spread
    from facts_damping_reproduction.ranking import Ranking, RankTotal
    from facts_damping_reproduction.results import Results


class Agreement(NamedTuple):
    """Cells, statements and orders beside the thesis's."""

    compared: list[Compared]
    statements: list[Statement]
    signs: list[Signs]
    signs_by_reference: list[Signs]
    rankings: list[Ranking]
    totals: list[RankTotal]


class Reached(NamedTuple):
    """Part of the improvement from LLC to the bound that a controller reaches, %; none: a run is without figures."""

    system: str
    scenario: str
    who: str
    quantity: str
    fraction: float | None


class Findings(NamedTuple):
    """What follows: of the scenarios as they are, of the medians over the ensembles."""

    plain: Agreement
    drawn: Agreement
    spreads: list[Spread]
    firmness: list[Firmness]
    decided: list[Decided]
    reached: list[Reached]


def find(results: Results) -> Findings:
    """Everything that the pages tell."""
    behind = [
        (rows, link)
        for link, ensemble in (("ideal", results.ensembles), (LINK, results.delayed))
        for rows in ensemble.values()
    ]
    unsure = {(run.system, run.who) for run in results.not_converged}
    sure = {run: figures for run, figures in results.figures.items() if (run.system, run.who) not in unsure}
    return Findings(
        _agreement(agreement.compare(results.cells, results.figures, results.not_converged)),
        _agreement(ensembles.compare(results.cells, results.ensembles)),
        [spread for rows, link in behind for spread in ensembles.spreads(rows, link)],
        ensembles.firmness(sure, results.ensembles),
        ensembles.decided(sure),
        _reached(results),
    )


def _agreement(compared: list[Compared]) -> Agreement:
    stated, ranked = agreement.statements(compared), ranking.rankings(compared)
    improvements = [statement for statement in stated if statement.what == agreement.IMPROVEMENT]
    named = [statement._replace(what=f"improvement over {statement.over}") for statement in improvements]
    return Agreement(compared, stated, agreement.signs(stated), agreement.signs(named), ranked, ranking.totals(ranked))


def _reached(results: Results) -> list[Reached]:
    runs = [run for run in results.figures if run.who not in (NOBODY, LLC)]
    return [
        Reached(run.system, run.scenario, name(run.who), index, reached(results.figures, run, index))
        for run in runs
        for index in THESIS_INDICES
    ]
