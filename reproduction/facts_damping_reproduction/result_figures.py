"""The figures of docs/delay_results.md, supervision_results.md and reproduction.md, from the tables beside them.

    python -m facts_damping_reproduction.result_figures docs/images

reads `delay_margin/margins.csv` and the like in that folder, and writes `results/*.png`. Each can be read at 400 px.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matplotlib.figure import Figure

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.control.table import kind_name
from facts_damping.output.picture_files import save_picture

if TYPE_CHECKING:
    from collections.abc import Sequence

Rows = list[dict[str, str]]

WIDTH, DPI = 4.4, 180  # inches, dots per inch: pages show less than half of the dots
CAMPAIGNS = (
    ("do_no_harm", "anything fails"),
    ("wrong_control", "control is wrong"),
    ("healthy", "nothing fails"),
)
HOLDS = 90.0  # %, drawn in another colour


def rows(path: Path) -> Rows:
    """A table as mappings."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def delay(margins: Rows) -> Figure:
    """By controller: the delays up to which it damps and keeps synchronism, from the worst scenario to the best."""
    spans: dict[str, dict[str, list[float]]] = {}
    schemes = {}
    for row in margins:
        who = f"{kind_name(row['controller'])} {row['scheme']}".strip()
        schemes[who] = row["scheme"]
        value = 0.0 if row["beyond"] == "low" else float(row["margin_s"] or row["low_s"])
        spans.setdefault(who, {}).setdefault(row["criterion"], []).append(value)
    order = sorted(spans, key=lambda who: -min(spans[who]["not_damped"]))
    figure = Figure(figsize=(WIDTH, 5.6), layout="constrained")
    axes: Any = figure.subplots()
    for place, who in enumerate(order):
        for criterion, colour, words in (
            ("unstable", "0.7", "synchronism"),
            ("not_damped", COLOURS[0], "damped"),
        ):
            delays = spans[who][criterion]
            shift = 0.17 if criterion == "unstable" else -0.17
            axes.plot(
                [min(delays), max(delays)], [place + shift] * 2, color=colour, lw=3, label=words if not place else None
            )
            axes.plot(delays, [place + shift] * len(delays), "|", color=colour, ms=6, mew=2)
    axes.set_yticks(range(len(order)), order, fontsize=8)
    axes.invert_yaxis()
    axes.set(xlim=(-0.01, 0.6))
    axes.set_xlabel("largest delay [s], in three scenarios", fontsize=9)
    axes.grid(visible=True, axis="x", color="0.92")
    axes.legend(fontsize=8, loc="lower right")
    return figure


def supervision(tables: Sequence[tuple[str, Rows]]) -> Figure:
    """By campaign: cases that get worse than without control, with and without supervision."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    axes: Any = figure.subplots(2, 1)
    text: Any = {"va": "center", "fontsize": 8}
    titles = ("synchronism lost", "harm: ITAE more than 5 % above, or lost")
    for axis, title, row in zip(axes, titles, (1, 2), strict=True):
        for place, (_, table) in enumerate(tables):
            for shift, column, colour, words in (
                (-0.2, "without supervision", "0.65", "without supervision"),
                (0.2, "with supervision", COLOURS[0], "with supervision"),
            ):
                value, low, high = (float(table[row][f"{column}, {end}"]) for end in ("percent", "low", "high"))
                axis.barh(place + shift, value, 0.36, color=colour, label=words if not place else None)
                axis.plot([low, high], [place + shift] * 2, color="black", lw=1)
                axis.annotate(f"{value:.2f}", (high, place + shift), (3, 0), textcoords="offset points", **text)
        axis.set_yticks(range(len(tables)), [words for words, _ in tables], fontsize=8)
        axis.invert_yaxis()
        axis.margins(x=0.15)
        axis.set_title(title, fontsize=9, loc="left")
    axes[0].legend(fontsize=8, loc="lower right")
    axes[1].set_xlabel("% of cases; no control keeps synchronism", fontsize=9)
    return figure


def agreement(counts: Rows) -> Figure:
    """How often each statement of the thesis holds here."""
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    axes: Any = figure.subplots()
    fractions = [100.0 * int(row["here"]) / int(row["of"]) for row in counts]
    colours = [COLOURS[0] if fraction > HOLDS else COLOURS[1] for fraction in fractions]
    bars = axes.barh(range(len(counts)), fractions, color=colours)
    texts = [f"{row['here']} of {row['of']}" for row in counts]
    axes.bar_label(bars, texts, fontsize=8, padding=3)
    axes.set_yticks(range(len(counts)), [row["statement"].replace(", ", ",\n") for row in counts], fontsize=8)
    axes.invert_yaxis()
    axes.axvline(50.0, color="0.4", lw=0.8, ls="--")
    axes.set(xlim=(0.0, 160.0), xticks=(0, 50, 100))
    axes.set_xlabel("cases in which it holds here [%]", fontsize=9)
    return figure


def main(folder: Path) -> None:
    """Draw all figures of a folder."""
    tables = [(words, rows(folder / name / "table_outcomes.csv")) for name, words in CAMPAIGNS]
    figures = {
        "delay": delay(rows(folder / "delay_margin" / "margins.csv")),
        "supervision": supervision(tables),
        "thesis": agreement(rows(folder / "reproduction" / "agreement.csv")),
    }
    (folder / "results").mkdir(exist_ok=True)
    for name, figure in figures.items():
        save_picture(figure, folder / "results" / f"{name}.png", dpi=DPI, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
