"""Pictures of the agreement: theirs against ours, orders over the ensemble, set-ups beside each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.indices import THESIS_INDICES
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping_reproduction.printed import LLC, ROUGHNESS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from facts_damping_reproduction.agreement import Compared, Signs
    from facts_damping_reproduction.ensembles import Spread
    from facts_damping_reproduction.explanations import Told
    from facts_damping_reproduction.ranking import Ranking

SHOWN = "ITAE"  # of ensembles
MINIMUM = -100.0  # %, worse improvements are drawn there
MARKERS = "os^D"


def improvements(title: str, compared: Sequence[Compared]) -> Figure:
    """Improvement over LLC, theirs across, ours upwards: an axes an index, a colour a scenario."""
    over_llc = [c for c in compared if c.cell.against == LLC]
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    axes: Any = figure.subplots(1, len(THESIS_INDICES), sharex=True, sharey=True)
    scenarios = list(dict.fromkeys(c.cell.scenario for c in over_llc))
    for axis, index in zip(axes, THESIS_INDICES, strict=True):
        for colour, marker, scenario in zip(COLOURS, MARKERS, scenarios, strict=False):
            marks = [c for c in over_llc if (c.cell.scenario, c.cell.quantity) == (scenario, index)]
            places = [(c.cell.corrected, MINIMUM if c.ours is None else max(c.ours, MINIMUM)) for c in marks]
            axis.plot(*np.array(places).reshape(-1, 2).T, marker, color=colour, ms=4, alpha=0.8, label=scenario)
        axis.axline((0.0, 0.0), slope=1.0, color="0.6", lw=0.8)
        axis.axhline(0.0, color="0.6", lw=0.8, ls="--")
        axis.set(title=index, xlabel="theirs [%]")
        axis.grid(visible=True, color="0.92")
    axes[0].set_ylabel("ours [%]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(f"{title}, over LLC", fontweight="bold", fontsize="medium")
    return figure


def roughness(title: str, compared: Sequence[Compared]) -> Figure:
    """Roughness, theirs across, ours upwards, a colour an architecture and scheme."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axis: Any = figure.subplots()
    kinds = list(dict.fromkeys((c.cell.architecture, c.cell.scheme or "LLC") for c in compared))
    for colour, marker, kind in zip(COLOURS, MARKERS * 2, kinds, strict=False):
        marks = [c for c in compared if (c.cell.architecture, c.cell.scheme or "LLC") == kind and c.ours]
        places = np.array([(c.cell.corrected, c.ours) for c in marks]).reshape(-1, 2)
        axis.plot(*places.T, marker, color=colour, ms=5, alpha=0.8, label=" ".join(kind))
    axis.set(xscale="log", yscale="log", xlabel="theirs", ylabel="ours [p.u./s²]")
    axis.grid(visible=True, color="0.92")
    axis.legend(fontsize="small")
    figure.suptitle(title, fontweight="bold", fontsize="medium")
    return figure


def ensemble(system: str, spreads: Sequence[Spread], plain: Mapping[tuple[str, str], float | None]) -> Figure:
    """Improvement of an index over LLC of every controller: median over the draws with its interval, and as it is.

    `plain`: improvement in the scenario as it is, %, by scenario and controller.
    """
    scenarios, whos = (
        list(dict.fromkeys(getattr(spread, field) for spread in spreads)) for field in ("scenario", "who")
    )
    whos = [who for who in whos if who not in ("MISO none", "MISO LLC")]
    figure = Figure(figsize=(3.4 * len(scenarios) + 1.5, 1.6 + 0.2 * len(whos)), layout="constrained")
    axes: Any = figure.subplots(1, len(scenarios), sharey=True, squeeze=False)
    for axis, scenario in zip(axes[0], scenarios, strict=True):
        for spread in spreads:
            if spread.scenario == scenario and spread.who in whos:
                row, inner = whos.index(spread.who), np.maximum(spread.over_llc, MINIMUM)
                axis.plot(inner[1:], [row, row], color=COLOURS[0], lw=2.5, alpha=0.6)
                axis.plot(inner[0], row, "o", color=COLOURS[0], ms=4, label="median and its 95 % interval")
                unvaried = plain.get((scenario, spread.who))
                if unvaried is not None:
                    axis.plot(max(unvaried, MINIMUM), row, "x", color=COLOURS[1], ms=5, label="the scenario as it is")
        axis.set(title=scenario, xlabel=f"improvement of {SHOWN} over LLC [%]")
        axis.grid(visible=True, color="0.92")
    axes[0, 0].set_yticks(range(len(whos)), whos, fontsize="small")
    axes[0, 0].invert_yaxis()
    handles, labels = axes[0, 0].get_legend_handles_labels()
    entries = dict(zip(labels, handles, strict=True))
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=2)
    figure.suptitle(f"{system}: over the ensembles", fontweight="bold", fontsize="medium")
    return figure


def verdict(signs: Sequence[Signs], rankings: Sequence[Ranking]) -> Figure:
    """Which of the thesis's statements hold: equal signs by whom it compares with, and how orders go together."""
    start = "improvement over MISO "
    whole = [sign_row for sign_row in signs if sign_row.table == "all" and sign_row.what.startswith(start)]
    figure = Figure(figsize=(10.0, 3.0), layout="constrained")
    axes: Any = figure.subplots(1, 2)
    fractions = [100.0 * sign_row.fraction for sign_row in whole]
    bars = axes[0].barh(
        range(len(whole)), fractions, color=[COLOURS[0] if fraction > 95.0 else COLOURS[1] for fraction in fractions]
    )
    axes[0].bar_label(bars, [f" {sign_row.agree} of {sign_row.statements}" for sign_row in whole], fontsize="small")
    axes[0].set_yticks(range(len(whole)), [f"over {sign_row.what.removeprefix(start)}" for sign_row in whole])
    axes[0].invert_yaxis()
    axes[0].axvline(50.0, color="0.4", lw=0.8, ls="--")
    axes[0].set(xlim=(0.0, 120.0), xlabel="improvements with the thesis's sign [%]")
    known = [order.rho for order in rankings if order.rho is not None]
    axes[1].hist(known, bins=np.linspace(-1.0, 1.0, 17), color=COLOURS[0], alpha=0.8)
    axes[1].axvline(float(np.mean(known)), color=COLOURS[1], lw=2.0, label=f"mean, {np.mean(known):.2f}")
    axes[1].set(xlabel="rank correlation of an order with the thesis's", ylabel="orders", xlim=(-1.0, 1.0))
    axes[1].legend()
    return figure


def variants(told_rows: Sequence[Told]) -> Figure:
    """Agreement with the thesis of every set-up: signs and rank correlation, a mark a table."""
    names, tables = (list(dict.fromkeys(getattr(row, field) for row in told_rows)) for field in ("variant", "table"))
    figure = Figure(figsize=(10.0, 1.4 + 0.27 * len(names)), layout="constrained")
    axes: Any = figure.subplots(1, 2, sharey=True)
    for axis, field, label in zip(
        axes, ("signs", "rho"), ("fraction of equal signs", "mean rank correlation"), strict=True
    ):
        for colour, marker, table in zip(COLOURS, MARKERS * 2, tables, strict=False):
            points = [(getattr(row, field), names.index(row.variant)) for row in told_rows if row.table == table]
            places = np.array([place for place in points if place[0] is not None], float).reshape(-1, 2)
            axis.plot(*places.T, marker, color=colour, ms=5, alpha=0.8, label=f"table {table}")
        axis.set(xlabel=label)
        axis.grid(visible=True, color="0.92")
    axes[1].axvline(0.0, color="0.6", lw=0.8)
    axes[0].set_yticks(range(len(names)), names)
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def of_table(table: str, title: str, compared: Sequence[Compared]) -> Figure:
    """The picture of a table's agreement."""
    kind = roughness if compared[0].cell.quantity == ROUGHNESS else improvements
    return kind(f"Table {table}. {title}", compared)
