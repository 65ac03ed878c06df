"""Results over an ensemble of draws: medians with intervals, improvements draw by draw, how firm an order is.

A run that loses synchronism, or fails, counts as infinitely bad: medians bear that.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy import stats
from scipy.stats import rankdata

from facts_damping_reproduction.agreement import Compared, ComparedRun, name
from facts_damping_reproduction.printed import LLC, SCENARIOS
from facts_damping_reproduction.ranking import rho
from facts_damping_reproduction.runs import FIGURES, TUNED

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from facts_damping_reproduction.agreement import Figures
    from facts_damping_reproduction.printed import Cell, ControllerId

    Row = dict[str, Any]
    Ensembles = Mapping[tuple[str, str], Sequence[Row]]  # by system and scenario

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """A median and its 95 % interval, which rests on order statistics (the binomial distribution), on no law."""

    median: float
    low: float
    high: float


class Spread(NamedTuple):
    """A figure of a controller over the draws of a scenario, its improvement over LLC, and over LLC-tuned."""

    system: str
    scenario: str
    link: str
    who: str
    quantity: str
    draws: int
    unstable: int
    figure: Interval
    over_llc: Interval  # %
    over_tuned: Interval  # %
    best: float  # fraction of the draws in which it is the best of all


class Firmness(NamedTuple):
    """How firm the order of the networks of a scheme is in a scenario."""

    system: str
    scenario: str
    quantity: str
    scheme: str
    first: str  # of the scenario as it is
    first_in_draws: float  # fraction of the draws in which it is first
    first_of_medians: str
    rho: float | None  # Spearman's, between the order of the scenario as it is and that of the medians
    rho_in_draws: float  # its mean between the order of the scenario as it is and that of a draw


class Decided(NamedTuple):
    """Who has the best mean place over the scenarios of a system, and whose scenario decides that.

    `deciding`: scenarios without which somebody else has it.
    """

    system: str
    quantity: str
    scheme: str
    first: str
    deciding: tuple[str, ...]


def values(rows: Iterable[dict[str, Any]], quantity: str) -> dict[str, NDArray[np.float64]]:
    """A figure draw by draw, by the controllers' names: (draws,), infinite where a run is unstable."""
    by_who: dict[str, list[float]] = {}
    for row in rows:
        known = row["error"] is None and row["stable"] and row[quantity] is not None
        by_who.setdefault(row["who"], []).append(row[quantity] if known else np.inf)
    return {who: np.array(draw_figures) for who, draw_figures in by_who.items()}


def median(x: NDArray[np.float64]) -> Interval:
    """Median and its interval; an end is an order statistic, infinite where there are too few values for one."""
    n, ordered = len(x), np.sort(x)
    outside = int(stats.binom.ppf((1 - CONFIDENCE) / 2, n, 0.5))  # so many values on either side are left out
    if outside < 1:
        return Interval(float(np.median(x)), -np.inf, np.inf)
    return Interval(float(np.median(x)), float(ordered[outside - 1]), float(ordered[n - outside]))


def improvements(reference: NDArray[np.float64], figures: NDArray[np.float64]) -> NDArray[np.float64]:
    """Improvement (4.109) draw by draw, %: 100 where only the reference is unstable, 0 where both are."""
    with np.errstate(invalid="ignore"):
        percent = np.asarray(100 * (1 - figures / reference))
    return np.where(np.isinf(reference), np.where(np.isinf(figures), 0.0, 100.0), percent)


def spreads(rows: Sequence[Row], link: str) -> list[Spread]:
    """Every figure of every controller over the draws of a scenario."""
    spread_rows = []
    for quantity in FIGURES:
        x = values(rows, quantity)
        lowest = np.min(list(x.values()), axis=0)
        spread_rows += [
            Spread(
                system=rows[0]["system"],
                scenario=rows[0]["scenario"],
                link=link,
                who=who,
                quantity=quantity,
                draws=len(draw_figures),
                unstable=int(np.isinf(draw_figures).sum()),
                figure=median(draw_figures),
                over_llc=median(improvements(x[name(LLC)], draw_figures)),
                over_tuned=median(improvements(x[name(TUNED)], draw_figures)),
                best=float(np.mean((draw_figures == lowest) & np.isfinite(draw_figures))),
            )
            for who, draw_figures in x.items()
        ]
    return spread_rows


def drawn(cell: Cell, rows: Ensembles) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw by draw the figure of a cell's controller, and what stands in the cell: the improvement, or the figure."""
    x = values(rows[cell.system, cell.scenario], cell.quantity)
    draw_figures = x[name(cell.who)]
    return draw_figures, draw_figures if cell.against is None else improvements(x[name(cell.against)], draw_figures)


def compare(cells: Iterable[Cell], rows: Ensembles) -> list[Compared]:
    """Ours of every cell by medians: of the figure, and of its improvement draw by draw."""
    return [_compared(cell, *(float(np.median(x)) for x in drawn(cell, rows))) for cell in cells]


def _compared(cell: Cell, figure: float, ours: float) -> Compared:
    if not np.isfinite([figure, ours]).all():
        return Compared(cell, None, None, None)
    return Compared(cell, figure, ours, ours - cell.corrected)


def firmness(figures: Figures, rows: Ensembles, quantities: Sequence[str] = FIGURES) -> list[Firmness]:
    """How firm the orders are: the networks of a scheme and architecture in each scenario."""
    firm_orders = []
    for (system, scenario), runs in rows.items():
        for quantity in quantities:
            x = values(runs, quantity)
            for label, group in _groups(figures, system, scenario).items():
                drawn = np.array([x[name(who)] for who in group])
                plain = np.array([_known(figures[ComparedRun(system, scenario, who)], quantity) for who in group])
                middle, first = np.median(drawn, axis=1), int(np.argmin(plain))
                each = [rho(plain, draw) or 0.0 for draw in drawn.T]
                firm_orders.append(
                    Firmness(
                        *(system, scenario, quantity, label, name(group[first])),
                        float(np.mean(np.argmin(drawn, axis=0) == first)),
                        name(group[int(np.argmin(middle))]),
                        rho(plain, middle),
                        float(np.mean(each)),
                    )
                )
    return firm_orders


def decided(figures: Figures, quantities: Sequence[str] = FIGURES) -> list[Decided]:
    """Whose mean place over the scenarios of a system is the best, and which single scenario decides that."""
    decisions = []
    for system, scenarios in SCENARIOS.items():
        names = [scenario for scenario in scenarios.values() if any(run[:2] == (system, scenario) for run in figures)]
        groups = _groups(figures, system, names[0]) if names else {}
        for quantity in quantities:
            for label, group in groups.items():
                plain = [
                    [_known(figures[ComparedRun(system, scenario, who)], quantity) for who in group]
                    for scenario in names
                ]
                places = np.array([rankdata(row) for row in plain])
                first = int(np.argmin(places.mean(axis=0)))
                without = [np.delete(places, i, axis=0).mean(axis=0) for i in range(len(names))] if names[1:] else []
                deciding = tuple(
                    scenario for scenario, left in zip(names, without, strict=False) if np.argmin(left) != first
                )
                decisions.append(Decided(system, quantity, label, name(group[first]), deciding))
    return decisions


def _groups(figures: Figures, system: str, scenario: str) -> dict[str, list[ControllerId]]:
    """The networks that ran in a scenario, by architecture and scheme."""
    groups: dict[str, list[ControllerId]] = {}
    for run in figures:
        if run[:2] == (system, scenario) and run.who.scheme is not None:
            groups.setdefault(f"{run.who.architecture} {run.who.scheme}", []).append(run.who)
    return {label: group for label, group in groups.items() if len(group) > 1}


def _known(figures: Mapping[str, float] | None, quantity: str) -> float:
    return np.inf if figures is None else figures[quantity]
