"""A picture of margins as bars."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure
from matplotlib.patches import Patch

from facts_damping.analysis.convergence import MARK
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping_studies.margins.criteria import CRITERIA
from facts_damping_studies.sweeps.column_names import axis_label, column_words
from facts_damping_studies.sweeps.results import beneath, cell, label, margin_names, margin_text, ranked, reach, spans

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from facts_damping_studies.sweeps.sweep_rows import MarginRow

SCHEMES = {None: COLOURS[6], "direct": COLOURS[0], "indirect": COLOURS[1]}


def plot_margins(margins: Sequence[MarginRow], across: str) -> Figure:
    """Bars of margins, the largest on top, other criteria as diamonds: a panel for each value of `across`.

    Scenarios are below each other unless `across` is the scenario.
    """
    names, first = margin_names(margins, across), margins[0].criterion
    lines, columns = beneath(margins, across), list(dict.fromkeys(row.place[across] for row in margins))
    labels = [label(dict(zip(names, values, strict=True)), names) for values in reversed(ranked(margins, names))]
    size = (4.6 + 3.4 * len(columns), 1.1 + len(lines) * (0.7 + 0.27 * len(labels)))
    figure = Figure(figsize=size, layout="constrained")
    grid: Any = figure.subplots(len(lines), len(columns), sharey=True, sharex=True, squeeze=False)
    for (scenario, rows), panels in zip(lines.items(), grid, strict=True):
        for axes, column in zip(panels, columns, strict=True):
            column_rows = [row for row in rows if row.place[across] == column]
            for row in column_rows:
                (_bar if row.criterion == first else _diamond)(axes, labels.index(label(row.place, names)), row)
            _dress(axes, ", ".join(part for part in (scenario, cell(column)) if part), column_rows)
    grid[0][0].set_yticks(range(len(labels)), labels)
    for axes in grid[-1]:
        axes.set_xlabel(axis_label(margins[0].over_seeds.field))
    title = f"Smallest {column_words(margins[0].over_seeds.field)[0]} at which a run {CRITERIA[first].words}"
    if not all(row.over_seeds.monotonic for row in margins if row.criterion == first):
        title += "; again: where it does not, beyond that"
    if any(row.converged is False for row in margins):
        title += f"; {MARK} or grey: otherwise with half the integration step"
    figure.suptitle(title, x=0.01, ha="left", fontsize="medium")
    _margin_legend(figure, margins)
    return figure


def _dress(axes: Axes, title: str, rows: Sequence[MarginRow]) -> None:
    horizons = sorted({row.place["horizon_s"] for row in rows if row.place["horizon_s"]})
    axes.set_title(f"{title}, horizon {' / '.join(f'{h:g}' for h in horizons)} s")
    axes.grid(visible=True, axis="x", lw=0.3)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.16, y=0.01)


def _bar(axes: Axes, y: int, row: MarginRow) -> None:
    end, margin = reach(row), row.over_seeds
    alpha = 0.55 if margin.beyond == "high" else 1.0
    axes.barh(y, end, color=SCHEMES.get(row.place["scheme"], COLOURS[2]), height=0.72, alpha=alpha)
    if margin.low_s is not None and margin.high_s is not None:
        axes.plot([margin.low_s, margin.high_s], [y, y], "|-", color="0.1", lw=1.2, ms=7)
    text = f"{end:.3f}" if margin.margin_s is not None else margin_text(row)
    again = "" if margin.monotonic else f"  again {spans(margin.holds_again)}"
    again += f" {MARK}" if margin.margin_s is not None and row.converged is False else ""
    place: dict[str, Any] = {"xytext": (5, 0), "textcoords": "offset points", "va": "center", "fontsize": "x-small"}
    axes.annotate(text + again, (max(end, margin.high_s or 0.0), y), **place)


def _diamond(axes: Axes, y: int, row: MarginRow) -> None:
    at = row.over_seeds.high_s if row.over_seeds.beyond == "low" else row.over_seeds.margin_s
    if at is not None:
        inside = "0.5" if row.converged is False else "white"
        axes.plot(at, y, "D", color=inside, mec="0.1", ms=4.5, clip_on=False, zorder=3)


def _margin_legend(figure: Figure, margins: Sequence[MarginRow]) -> None:
    schemes = [scheme for scheme in SCHEMES if any(row.place["scheme"] == scheme for row in margins)]
    handles: list[Any] = [Patch(color=SCHEMES[scheme], label=scheme or "no adaptation") for scheme in schemes]
    axes = figure.axes[0]
    for criterion in dict.fromkeys(row.criterion for row in margins):
        if criterion != margins[0].criterion:
            text = f"first value at which it {CRITERIA[criterion].words}"
            handles += axes.plot([], [], "D", color="white", mec="0.1", ms=4.5, label=text)
    handles += axes.plot([], [], "|-", color="0.1", lw=1.2, ms=7, label="bracket or 95 % interval")
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), fontsize="small", frameon=False)
