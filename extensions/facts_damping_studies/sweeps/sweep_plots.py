"""Pictures of a sweep from its table; the swept columns determine which ones are drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.convergence import MARK
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping_studies.margins.criteria import fails
from facts_damping_studies.margins.margins import failed_fraction
from facts_damping_studies.pages import headline, legend, save
from facts_damping_studies.sweeps.column_names import axis_label, value_label
from facts_damping_studies.sweeps.margin_plots import plot_margins
from facts_damping_studies.sweeps.results import by_scenario, counted, label, shortcomings, varying
from facts_damping_studies.sweeps.sweep import differ
from facts_damping_studies.sweeps.sweep_rows import LATENCIES, QUANTILES

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from numpy.typing import NDArray

    from facts_damping_studies.sweeps.sweep_rows import MarginRow, SweepRow

    Rows = Sequence[SweepRow]

STYLES = ("-", "--", ":", "-.")
CURVES = {
    "ITAE": "ITAE [p.u. s²]",
    "interarea_damping_ratio": "interarea damping ratio",
    "roughness": "roughness [p.u./s²]",
}
FRACTIONS = {"unstable": "fraction of unstable runs", "not_damped": "fraction of runs not damped"}
BINS = 20  # of a random variable
MINIMUM = 3  # number of values for an axis
MAX_ACROSS = 5  # largest number of panels of a map per row
MAX_TICKS = 12  # largest number of ticks of a map with a tick per value
MAX_GROUPS = 30  # largest number of distinguishable curves
MAX_TOGETHER = 8  # largest number of groups with all figures in one picture
SPREAD_MS = 1e-3  # a smaller variation of latency is not drawn as a distribution
LOST_RUNS = "Open circles: so many of the runs lose synchronism, which counts as worst. No line: half or more do."
LEFT_OUT = "Runs that do otherwise with half the integration step are left out."
MAX_DISTINCT = 60  # a column with more values counts as random


def plot(rows: Rows, swept: Sequence[str], margins: Sequence[MarginRow], across: str, folder: Path) -> list[Path]:
    """Draw all pictures for which the table has data; `swept`: the swept columns."""
    sound = [row for row in rows if not row.error]
    axes = sorted(numeric(sound, swept), key=lambda name: -len({row.columns[name] for row in sound}))
    figures: dict[str, Figure | None] = {"margins": plot_margins(margins, across) if margins else None}
    few = len(groups(sound, swept, axes)) <= MAX_GROUPS
    if axes and sound and few:
        x = next((margin.over_seeds.field for margin in margins), axes[0])
        figures["curves"] = plot_curves(sound, x, swept, axes)
        others = [name for name in axes if name != x]
        for criterion, ending in zip(FRACTIONS, ("", "_not_damped"), strict=True):
            figures[f"probability{ending}"] = plot_probability(sound, x, swept, axes, criterion)
            figures[f"map{ending}"] = plot_map(sound, x, others[0], swept, criterion) if others else None
    figures["latency"] = plot_latency(sound, swept) if few else None
    paths = []
    for stem, figure in figures.items():
        if figure is not None:
            headline(figure, shortcomings(rows, hints=False))
            paths.append(save(figure, folder / f"{stem}.png"))
    return paths


def numeric(rows: Rows, swept: Sequence[str]) -> list[str]:
    """Swept numeric columns with at least three values, without the seed."""
    names = []
    for name in dict.fromkeys(swept):
        values = [row.columns.get(name) for row in rows]
        if name != "seed" and all(type(value) in (int, float) for value in values) and len(set(values)) >= MINIMUM:
            names.append(name)
    return names


def groups(
    rows: Rows, swept: Sequence[str], without: Sequence[str], every: Rows | None = None
) -> dict[str, list[SweepRow]]:
    """Rows by a label of the columns that vary (in all of `every`, if given), except these, scenario and seed."""
    places = dict.fromkeys(["system", "controller", "scheme", "link", *swept, "horizon_s"])
    grouped_by = [name for name in places if name not in (*without, "scenario", "seed")]
    names = varying(
        [{name: row.cells.get(name) for name in grouped_by} for row in (rows if every is None else every)], ()
    )
    by_label: dict[str, list[SweepRow]] = {}
    for row in rows:
        by_label.setdefault(label(row.cells, names), []).append(row)
    return by_label


def styles() -> Iterator[dict[str, Any]]:
    """Line styles: colours first, then other dashes."""
    for style in STYLES * 10:
        for colour in COLOURS:
            yield {"color": colour, "linestyle": style}


def settings(rows: Rows, axes: Sequence[str], x: str) -> dict[str, list[SweepRow]]:
    """Rows by scenario, and by the values of the other numeric axes, so that a curve over x is one setting.

    Of an axis with many values a few are shown, the first and the last among them; random ones are not told apart.
    """
    by_setting = by_scenario(rows)
    for name in axes:
        values = sorted({row.columns[name] for row in rows})
        if name == x or not 1 < len(values) <= MAX_DISTINCT:
            continue
        number = min(len(values), max(2, MAX_ACROSS // len(by_setting)))
        shown_values = [values[round(i * (len(values) - 1) / (number - 1))] for i in range(number)]
        by_setting = {
            f"{title}, {value_label(name, value)}".removeprefix(", "): [
                r for r in setting_rows if r.columns[name] == value
            ]
            for title, setting_rows in by_setting.items()
            for value in shown_values
        }
    return {title: setting_rows for title, setting_rows in by_setting.items() if setting_rows}


def _panels(columns: Mapping[str, Rows], titles: Sequence[str], x: str) -> tuple[Figure, dict[str, Any]]:
    """A figure with a column of panels for each setting, one below the other, and their axes."""
    figure = Figure(figsize=(3.0 + 4.0 * len(columns), 1.2 + 2.6 * len(titles)), layout="constrained")
    panels: Any = figure.subplots(len(titles), len(columns), sharex=True, sharey="row", squeeze=False)
    for j, title in enumerate(columns):
        panels[0, j].set_title(title)
        panels[-1, j].set_xlabel(axis_label(x))
        for axes in panels[:, j]:
            axes.grid(visible=True, lw=0.3)
            axes.spines[["top", "right"]].set_visible(False)
    for axes, title in zip(panels[:, 0], titles, strict=True):
        axes.set_ylabel(title)
    return figure, {title: panels[:, j] for j, title in enumerate(columns)}


def plot_curves(rows: Rows, x: str, swept: Sequence[str], axes: Sequence[str]) -> Figure | None:
    """Index, damping ratio and roughness against a numeric axis: medians, with points for random values.

    A run that loses synchronism counts as worse than all others: a median has a gap where half of the runs do, and an
    open circle with their number where fewer do. Runs that are not converged are left out.

    With more than eight groups only ITAE is drawn, the direct and indirect schemes separately; controllers without
    adaptation appear in both.
    """
    shown = {name: title for name, title in CURVES.items() if any(row.cells.get(name) is not None for row in rows)}
    if not shown:
        return None
    columns = settings(rows, axes, x)
    schemes = [scheme for scheme in dict.fromkeys(row.columns["scheme"] for row in rows) if scheme]
    if len(groups(rows, swept, axes)) <= MAX_TOGETHER or not schemes:
        parts = [(title, name, {None, *schemes}) for name, title in shown.items()]
    else:
        parts = [(f"{CURVES['ITAE']}, {scheme}", "ITAE", {None, scheme}) for scheme in schemes]
        columns_of = [row.columns for row in rows]
        same = [name for name in swept if all(scheme.get(name) == scheme["scheme"] for scheme in columns_of)]
        axes = [*axes, "scheme", *same]
    figure, panels = _panels(columns, [title for title, _, _ in parts], x)
    looks, lost = dict(zip(groups(rows, swept, axes), styles(), strict=False)), False
    for setting, setting_rows in columns.items():
        for group, some in groups(setting_rows, swept, axes, rows).items():
            for panel, (_, name, schemes_shown) in zip(panels[setting], parts, strict=True):
                plotted = [row for row in some if row.columns["scheme"] in schemes_shown]
                values = np.array([counted(row, name) for row in plotted])
                lost |= _curve(panel, np.array([row.columns[x] for row in plotted], float), values, looks[group], group)
                panel.set_yscale("linear" if name.startswith("interarea") else "log")
    notes = [LOST_RUNS] if lost else []
    notes += [LEFT_OUT] if any(row.unsure for row in rows) else []
    figure.suptitle("\n".join(notes), fontsize="small")
    legend(figure, loc="outside right center")
    return figure


def _curve(panel: Axes, x: NDArray[np.float64], y: NDArray[np.float64], style: dict[str, Any], name: str) -> bool:
    """Medians of values against x, with gaps where they are missing or infinite; many values are points as well.

    Returns whether runs were lost where there is a median.
    """
    if not len(x):
        return False
    if len(np.unique(x)) > MAX_DISTINCT:
        faint = max(0.05, min(0.5, 300 / len(x)))
        panel.plot(x, y, ".", color=style["color"], ms=2, alpha=faint)
    middles, parts = binned(x)
    known = [y[part][~np.isnan(y[part])] for part in parts]
    medians = np.array([float(np.median(at_x)) if len(at_x) else np.nan for at_x in known])
    medians[np.isinf(medians)] = np.nan
    panel.plot(middles, medians, label=name, lw=1.2, **style)
    marked = [i for i, at_x in enumerate(known) if np.isinf(at_x).any() and not np.isnan(medians[i])]
    for i in marked:
        place: dict[str, Any] = {"xytext": (3, 3), "textcoords": "offset points", "fontsize": 6}
        panel.plot(middles[i], medians[i], "o", color=style["color"], mfc="white", ms=4)
        text = f"{np.isinf(known[i]).sum()}/{len(known[i])}"
        panel.annotate(text, (middles[i], float(medians[i])), color=style["color"], **place)
    return bool(marked)


def binned(x: NDArray[np.float64]) -> tuple[list[float], list[NDArray[np.bool_]]]:
    """Group values and the members of each group: single values, or bins of equal width if there are many."""
    distinct = np.unique(x)
    if len(distinct) <= MAX_DISTINCT:
        return [float(value) for value in distinct], [x == value for value in distinct]
    edges = np.linspace(distinct[0], distinct[-1], BINS + 1)
    at = np.clip(np.digitize(x, edges) - 1, 0, BINS - 1)
    filled_bins = [i for i in range(BINS) if np.any(at == i)]
    return [float((edges[i] + edges[i + 1]) / 2) for i in filled_bins], [at == i for i in filled_bins]


def plot_probability(rows: Rows, x: str, swept: Sequence[str], axes: Sequence[str], criterion: str) -> Figure | None:
    """Fraction of failed runs against a numeric axis with Wilson's interval; None if no two runs share a value."""
    columns = settings(rows, axes, x)
    figure, panels = _panels(columns, [f"{_fraction_label(rows, criterion)}, 95 % interval".replace(", ", ",\n", 1)], x)
    looks = dict(zip(groups(rows, swept, axes), styles(), strict=False))
    several = False
    for setting, setting_rows in columns.items():
        for group, some in groups(setting_rows, swept, axes, rows).items():
            failed = np.array([fails(criterion, row.judged) for row in some])
            middles, parts = binned(np.array([row.columns[x] for row in some], float))
            maximum = max(int(part.sum()) for part in parts)
            several |= maximum > 1
            # Bisection adds values with few seeds, those with a margin nearby.
            large_bins = [i for i, part in enumerate(parts) if part.sum() > maximum / 2 or len(parts) == BINS]
            middles, parts = [middles[i] for i in large_bins], [parts[i] for i in large_bins]
            fractions = [failed_fraction(int(failed[part].sum()), int(part.sum())) for part in parts]
            (panel,) = panels[setting]
            panel.plot(
                middles, [fraction.fraction for fraction in fractions], label=group, lw=1.3, marker=".", **looks[group]
            )
            ends = [fraction.low for fraction in fractions], [fraction.high for fraction in fractions]
            panel.fill_between(middles, *ends, color=looks[group]["color"], alpha=0.15, lw=0)
            panel.set_ylim(-0.02, 1.02)
    legend(figure, loc="outside right center")
    return figure if several else None


def plot_map(rows: Rows, x: str, y: str, swept: Sequence[str], criterion: str) -> Figure:
    """Fraction of failed runs over two numeric axes: a panel for each scenario and group, at most twelve.

    `~`: at least one of these runs changes its result with half the integration step.
    """
    panels = {
        ", ".join(text for text in (scenario, name) if text): some
        for scenario, scenario_rows in by_scenario(rows).items()
        for name, some in groups(scenario_rows, swept, (x, y), rows).items()
    }
    shown = list(panels.items())[:12]
    across = min(MAX_ACROSS, len(shown))
    down = -(-len(shown) // across)
    figure = Figure(figsize=(1.6 + 3.6 * across, 0.6 + 3.2 * down), layout="constrained")
    grid: Any = figure.subplots(down, across, squeeze=False).ravel()
    marked = False
    for axes, (title, some) in zip(grid, shown, strict=False):
        columns, wide = binned(np.array([row.columns[x] for row in some], float))
        lines, high = binned(np.array([row.columns[y] for row in some], float))
        failed = np.array([fails(criterion, row.judged) for row in some])
        fractions = [[failed[a & b].mean() if np.any(a & b) else np.nan for a in wide] for b in high]
        looks: dict[str, Any] = {"cmap": "cividis", "vmin": 0, "vmax": 1, "shading": "nearest"}
        at, up = _ticked(axes.xaxis, columns), _ticked(axes.yaxis, lines)
        image = axes.pcolormesh(at, up, np.array(fractions, float), **looks)
        changed = np.array(differ(some, criterion) or np.zeros(len(some)), bool)
        for i, j in np.argwhere([[np.any(changed & a & b) for a in wide] for b in high]):
            colour = "white" if fractions[i][j] < 0.5 else "black"  # cividis is dark for few failures
            axes.text(at[j], up[i], MARK, color=colour, ha="center", va="center", fontsize="large")
        marked |= bool(changed.any())
        axes.set(title=title, xlabel=axis_label(x), ylabel=axis_label(y))
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    text = _fraction_label(rows, criterion) + (f"\n{MARK} some do otherwise with half the step" if marked else "")
    figure.colorbar(image, ax=list(grid), label=text, shrink=0.8)
    return figure


def _fraction_label(rows: Rows, criterion: str) -> str:
    horizons = sorted({row.horizon_s or 0.0 for row in rows})
    return f"{FRACTIONS[criterion]}, horizon {' / '.join(f'{horizon:g}' for horizon in horizons)} s"


def _ticked(axis: Axis, values: Sequence[float]) -> Sequence[float]:
    """Tick positions of an axis: few values at equal distances with a tick each, many values to scale."""
    if len(values) > MAX_TICKS:
        return values
    axis.set_ticks(range(len(values)), [f"{value:g}" for value in values])
    return range(len(values))


def _latencies(row: SweepRow) -> list[float]:
    """The quantiles of a run's latency, ms; empty if no setpoint acted."""
    latencies = {} if row.figures is None else row.figures.latency
    return [value for name in LATENCIES[1:] if (value := latencies.get(name)) is not None]


def plot_latency(rows: Rows, swept: Sequence[str]) -> Figure | None:
    """Distribution of the latency over all setpoints of a group's runs, from each run's quantiles.

    For swept numbers, at the least value of each. None if no latency varies.
    """
    varying_rows = [row for row in rows if (q := _latencies(row)) and q[-1] - q[0] > SPREAD_MS]
    if not varying_rows:
        return None
    title = []
    for name in numeric(rows, swept):
        if len({row.columns[name] for row in rows}) <= MAX_DISTINCT:
            minimum = min(row.columns[name] for row in varying_rows)
            varying_rows = [row for row in varying_rows if row.columns[name] == minimum]
            title.append(value_label(name, minimum))
    figure = Figure(figsize=(7.5, 3.8), layout="constrained")
    axes = figure.subplots()
    apart = groups(varying_rows, swept, ())
    apart = apart if len(apart) <= MAX_TOGETHER else groups(varying_rows, swept, numeric(varying_rows, swept))
    for (name, some), style in zip(apart.items(), styles(), strict=False):
        quantiles = np.array([_latencies(row) for row in some], float)
        at = np.unique(quantiles)
        at = np.concatenate([[at[0] - 1e-9], at]) if len(at) < 2000 else np.linspace(at[0] - 1e-9, at[-1], 2000)
        # Fraction of a run's setpoints with at most a latency, by linear interpolation between its quantiles.
        rising, levels = 1e-9 * np.arange(len(QUANTILES)), np.array(QUANTILES) / 100
        steps = np.maximum.accumulate(quantiles, axis=1) + rising
        below = [
            np.interp(at + 1e-9 * len(QUANTILES), run_latencies, levels, left=0.0, right=1.0) for run_latencies in steps
        ]
        fractions = np.mean(below, axis=0)
        axes.plot(at, 100 * fractions, label=name, lw=1.3, **style)
    axes.set(xlabel="latency from measurement to device [ms]", ylabel="setpoints with at most that [%]", ylim=(-1, 101))
    axes.set_title(", ".join(title), fontsize="medium")
    axes.grid(visible=True, lw=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    legend(figure, loc="outside right center")
    return figure
