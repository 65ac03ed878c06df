"""Tables of a study's requested figures in Markdown, by system and scenario, and a picture of one figure."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter

from facts_damping.analysis.convergence import MARK, text
from facts_damping.analysis.indices import INDICES
from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping.analysis.verdict import DAMPED
from facts_damping.output import tables
from facts_damping_studies.pages import headline, legend, save
from facts_damping_studies.sweeps.control_outcomes import TRIPPED, marks
from facts_damping_studies.sweeps.results import cell, shortcomings, worst

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from facts_damping_studies.parameters import Tables
    from facts_damping_studies.sweeps.sweep_rows import SweepRow

    RowId = tuple[str, ...]  # identifies a row

NOTES, NOTHING = "notes", "-"  # last column of a table of figures, and its text if nothing is to be said
FAILED = "error"  # in place of a failed run's verdict
MAX_ACROSS = 6  # entries of the legend side by side
DECADE = 10.0  # values within it have a linear axis, whose labels do not overlap
MARKERS = ("o", "s", "^", "v", "D", "P")


def figure_tables(rows: Sequence[SweepRow], asked: Tables) -> list[str]:
    """One table per place with all figures; or, with `across`, one per figure and place."""
    lines: list[str] = []
    for place in dict.fromkeys(row.place for row in rows):
        place_rows = [row for row in rows if row.place == place]
        lines += [f"### {', '.join(place)}", ""]
        grouped: dict[tuple[RowId, str], list[SweepRow]] = {}
        for row in place_rows:
            grouped.setdefault((_row_id(row, asked), _column(row, asked)), []).append(row)
        if asked.across is None:
            lines += _side_by_side(asked, grouped)
            continue
        columns = list(dict.fromkeys(column for _, column in grouped))
        for figure in asked.figures:
            texts = {place: _among(runs, figure) for place, runs in grouped.items()}
            lines += [f"{figure}:", "", *_table(asked, columns, texts)]
    return lines


def _side_by_side(asked: Tables, grouped: Mapping[tuple[RowId, str], Sequence[SweepRow]]) -> list[str]:
    """A table with all figures, and a last column for runs that did not do what was asked, if there are any."""
    texts: dict[tuple[RowId, str], str] = {}
    for (who, _), runs in grouped.items():
        texts |= {(who, figure): _together(runs, figure) for figure in asked.figures}
        texts[who, NOTES] = _notes(runs)
    noted = any(texts[who, NOTES] != NOTHING for who, _ in grouped)
    return _table(asked, [*asked.figures, *([NOTES] if noted else [])], texts)


def _together(runs: Sequence[SweepRow], figure: str) -> str:
    """A figure beside others of its runs: the median of numbers, else each text with the number of its runs."""
    texts = [_alone(row, figure) for row in runs]
    if len(set(texts)) == 1 or not any(isinstance(row.cells.get(figure), str | bool) for row in runs):
        return texts[0] if len(runs) == 1 else _figure(runs, figure)
    return _counts(texts, len(runs))


def _notes(runs: Sequence[SweepRow]) -> str:
    """What kept runs from doing what was asked, with the monitors that tripped first."""
    odd = [mark for row in runs for mark in marks(row)]
    odd += [FAILED if row.figures is None else str(row.figures.instability) for row in runs if not row.stable]
    causes = dict.fromkeys(row.first_trip.cause for row in runs if row.first_trip is not None)
    by = f"{TRIPPED} by {' or '.join(causes)}"
    return _counts([by if mark == TRIPPED and causes else mark for mark in odd], len(runs)) or NOTHING


def _counts(words: Sequence[str], runs: int) -> str:
    """Words, each with the number of the runs that have it, if there are several runs."""
    return ", ".join(f"{count} of {runs} {word}" if runs > 1 else word for word, count in Counter(words).items())


def plot(rows: Sequence[SweepRow], asked: Tables, folder: Path) -> list[Path]:
    """Draw figures.png: the first numeric figure, a panel per place, a mark per value of `across`.

    Runs whose controller was tripped, was never armed or was at its limits have a cross; the title says which runs are
    left out.
    """
    sound = [row for row in rows if row.stable and not row.unsure]
    numbers = (name for name in asked.figures if any(type(row.cells.get(name)) is float for row in sound))
    figure = next(numbers, None)
    if figure is None:
        return []
    places = list(dict.fromkeys(row.place for row in rows))
    whos = list(dict.fromkeys(_row_id(row, asked) for row in rows))
    columns = list(dict.fromkeys(_column(row, asked) for row in rows))
    picture = Figure(figsize=(2.0 + 4.0 * len(places), 2.5 + 0.24 * len(whos)), layout="constrained")
    axes: Any = picture.subplots(1, len(places), sharey=True, squeeze=False)
    for axis, place in zip(axes[0], places, strict=True):
        for i, column in enumerate(columns):
            cell_rows = [row for row in sound if (*row.place, _column(row, asked)) == (*place, column)]
            values = [(row.cells.get(figure), whos.index(_row_id(row, asked))) for row in cell_rows]
            known = [pair for pair in values if pair[0] is not None]
            style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)], "ls": "", "alpha": 0.85}
            axis.plot(*np.array(known).reshape(-1, 2).T, ms=5, label=column, **style)
        crossed = [row for row in sound if row.place == place and marks(row) and row.cells.get(figure) is not None]
        at = [row.cells[figure] for row in crossed], [whos.index(_row_id(row, asked)) for row in crossed]
        axis.plot(
            *at,
            "x",
            color="black",
            ms=9,
            label=" or ".join(dict.fromkeys(mark for row in crossed for mark in marks(row))),
        )
        axis.set(xlabel=figure, title=", ".join(place))
        _scale(axis)
        axis.grid(visible=True, axis="both", lw=0.3)
    axes[0, 0].set_yticks(range(len(whos)), [" ".join(who).strip() for who in whos])
    axes[0, 0].invert_yaxis()
    legend(picture, loc="outside lower center", ncols=1 if asked.across is None else min(len(columns), MAX_ACROSS))
    lost = sum(row.figures is not None and not row.stable for row in rows)
    left_out = [f"{lost} runs lose synchronism: left out"] if lost else []
    headline(picture, [*shortcomings(rows, hints=False), *left_out])
    return [save(picture, folder / "figures.png")]


def _scale(axis: Any) -> None:
    """A logarithmic axis with a label per decade, or a linear one for values within a decade."""
    low, high = axis.dataLim.intervalx
    if low > 0.0 and high > DECADE * low:
        axis.set_xscale("log")
        axis.xaxis.set_minor_formatter(NullFormatter())
    else:
        axis.xaxis.set_major_locator(MaxNLocator(4))


def _column(row: SweepRow, asked: Tables) -> str:
    return "" if asked.across is None else cell(row.columns[asked.across])


def _row_id(row: SweepRow, asked: Tables) -> RowId:
    return tuple("" if row.columns.get(name) is None else cell(row.columns[name]) for name in asked.rows)


def _table(asked: Tables, columns: Sequence[str], texts: Mapping[tuple[RowId, str], str]) -> list[str]:
    titles = [name.rpartition(".")[2] for name in asked.rows]
    cells = [
        [*who, *(texts.get((who, column), "") for column in columns)] for who in dict.fromkeys(who for who, _ in texts)
    ]
    return [*tables.table([*titles, *columns], cells, len(titles), markdown=True), ""]


def _alone(row: SweepRow, figure: str) -> str:
    """A figure beside others of its run; if synchronism is lost, the reason replaces a yes or no."""
    value, instability = row.cells.get(figure), None if row.figures is None else row.figures.instability
    if figure == "verdict":
        return instability or str(value or FAILED)
    if isinstance(value, bool):
        return "yes" if value else instability or "no"
    return _figure([row], figure) if row.stable else "-"


def _figure(runs: Sequence[SweepRow], figure: str) -> str:
    """A figure, the median of several runs; with a halved step, only the digits that hold in all, or marked.

    A run that loses synchronism counts as worse than all others.
    """
    values = [value for row in runs if (value := row.cells.get(figure)) is not None]
    if not values or not isinstance(values[0], float):
        return cell(values[0] if values else None)
    middle = float(np.median([*values, *(worst(figure) for row in runs if not row.stable)]))
    if np.isinf(middle):
        return "-"
    unsure = any(row.unsure for row in runs)
    halves = [row.half_step for row in runs if row.half_step is not None]
    changes = [half.step_change for half in halves if half.step_change is not None]
    if not changes or not (unsure or figure in INDICES):
        return cell(middle)
    return (MARK if unsure else "") + text(middle, max(changes)).lstrip(MARK)


def _among(runs: Sequence[SweepRow], figure: str) -> str:
    """A figure beside those of others, marked if it does not count; for several runs (seeds) the median.

    For several runs the number of undamped ones is added.
    """
    words = [
        FAILED if row.figures is None else row.figures.verdict if row.stable else row.figures.instability or FAILED
        for row in runs
    ]
    odd = [*(word for word in words if word != DAMPED), *(mark for row in runs for mark in marks(row))]
    sound = [row for row in runs if row.stable]
    if not sound:
        return max(words, key=words.count)
    return _figure(runs, figure) + (f" ({_counts(odd, len(runs))})" if odd else "")
