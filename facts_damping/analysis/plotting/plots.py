"""Pictures of one or several overlaid records, as PNG files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from facts_damping.analysis.plotting.pictures import PICTURES, Curve, Panel, Picture, shown, title_of
from facts_damping.analysis.supervision import supervision, trips
from facts_damping.errors import InputError, check_known
from facts_damping.output.picture_files import save_picture
from facts_damping.signals import NANOSECONDS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from facts_damping.analysis.indices import Regions
    from facts_damping.record import Record

WIDTH, PANEL_HEIGHT, MARGIN = 9.0, 2.3, 1.3  # inch
DPI = 150
FAST = {"compress_level": 1}  # PNG option: a tenth of the time per picture for a fifth more bytes
# Okabe and Ito's palette without its yellow: distinct also for the colour-blind.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
SETPOINT, LIMIT, CLIFF = "setpoint in force", "limit", "ends of the cliff region"
REGIONS = {"error floor": 0.9, "cliff": 0.06, "small error": 0.06}  # relative heights of their names
NEARBY = 0.03  # of the time axis: closer events share a label
NEAR = 0.5  # of a limit: beyond it the limit is drawn
NARROW = 0.05  # of the time axis: narrower regions have no name


class Plotted(NamedTuple):
    """A record and its panels in a picture, by name."""

    record: Record
    panels: dict[str, Panel]


def plot_comparison(records: Sequence[tuple[str, Record]], folder: Path | str) -> list[Path]:
    """Plot several records (name, record) over each other; returns paths of the PNG files in `folder`, which exists.

    Draws those of `pictures.PICTURES` that are not empty. Records with the same name, such as seeds of a run, give
    their median in a band from minimum to maximum. Vertical lines mark the events of the first record. Raises
    InputError without records.
    """
    if not records:
        raise InputError("plots: no record given; allowed: at least one")
    place, paths = Path(folder), []
    for picture in PICTURES:
        figure = _figure(picture, records)
        if figure is not None:
            paths.append(save_picture(figure, place / f"{picture.stem}.png", dpi=DPI, pil_kwargs=FAST))
    return paths


def figure(names: Sequence[str], records: Sequence[tuple[str, Record]]) -> Figure:
    """One of the pictures by its name, or columns of the records (`Record.arrays`) over time, stacked.

    Raises `InputError` for an unknown name or an empty picture.
    """
    pictures = {picture.stem: picture for picture in PICTURES}
    if len(names) == 1 and names[0] in pictures:
        picture, reason = (
            pictures[names[0]],
            f"'{names[0]}' given, for which there are no data; allowed: another picture",
        )
    else:
        for name in names:
            check_known("plot", name, [*pictures, *records[0][1].arrays])

        def panels(record: Record) -> list[Panel]:
            return [Panel(f"{name} [{record.units[name]}]", {"": Curve(record.arrays[name])}) for name in names]

        picture, reason = Picture("columns", "", "", panels, together=False), "no name given; allowed: at least one"
    drawn = _figure(picture, records, still=True)
    if drawn is None:
        raise InputError(f"plot: {reason}")
    return drawn


def _figure(picture: Picture, records: Sequence[tuple[str, Record]], *, still: bool = False) -> Figure | None:
    """One picture; None if no record has data for it. `still`: include curves that never change."""
    groups: dict[str, list[Plotted]] = {}
    for name, record in records:
        of_record = {panel.name: panel for panel in picture.panels(record)}
        groups.setdefault(name, []).append(Plotted(record, of_record))
    panels = [plotted.panels for group in groups.values() for plotted in group]
    names = list(dict.fromkeys(name for panels_of in panels for name in panels_of)) if still else shown(picture, panels)
    if not names:
        return None
    single = len(records) == 1
    rows = [names] if single and picture.together else [[name] for name in names]
    figure = Figure(figsize=(WIDTH, MARGIN + PANEL_HEIGHT * max(len(rows), 1.5)), layout="constrained")
    grid = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    for axes, row in zip(grid, rows, strict=True):
        for position, (name, group) in enumerate(groups.items()):
            for offset, panel in enumerate(row):
                label = panel if single and picture.together else name
                having = [plotted for plotted in group if panel in plotted.panels]
                _draw(axes, having, panel, label, position + offset, named=bool(name))
        axes.set_ylabel(picture.label if len(row) > 1 else "\n".join(filter(None, (row[0], picture.label))))
        axes.grid(visible=True, color="0.92")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_yscale("log" if picture.logarithmic else "linear")
        if picture.words:
            axes.set_yticks(range(len(picture.words)), picture.words)
            axes.set_ylim(-0.5, len(picture.words) - 0.5)
    if picture.over_time:
        grid[-1].set_xlim(*_span([record for _, record in records]))
        mark_events(list(grid), records[0][1])
        for axes, row in zip(grid, rows, strict=True):
            for name in row if single else ():
                _name_regions(axes, panels[0][name].regions)
    grid[-1].set_xlabel(picture.over)
    figure.suptitle(title_of(picture, panels, names), fontsize="medium", fontweight="bold", x=0.01, ha="left")
    _add_legend(figure, list(grid))
    return figure


def _draw(axes: Axes, alike: Sequence[Plotted], name: str, label: str, place: int, *, named: bool) -> None:
    """The curves of one panel of records with the same name; if named and among others, all in one colour."""
    for i, (curve_name, first) in enumerate(alike[0].panels[name].curves.items() if alike else ()):
        curves = [plot.panels[name].curves[curve_name] for plot in alike if curve_name in plot.panels[name].curves]
        colour = COLOURS[(place if named else place + i) % len(COLOURS)]
        for x, values in _lines(axes, alike[0].record, curves, colour):
            axes.plot(
                x, values, color=colour, linewidth=1.2, drawstyle="steps-post" if first.steps else "default",
                label=label or curve_name or None,
            )  # fmt: skip
    for record, panel in ((plot.record, plot.panels[name]) for plot in alike):
        if panel.dashed is not None:
            axes.plot(record.time_s, panel.dashed, color="0.1", linewidth=0.6, linestyle="--", label=SETPOINT)
        for limit in panel.limits if _near(panel) else ():
            axes.axhline(limit, color="#B00020", linewidth=0.8, linestyle=":", label=LIMIT)
        if panel.regions is not None:
            (curve,) = panel.curves.values()
            ends = np.array(panel.regions[:2])
            heights = np.interp(ends, curve.x, curve.values) if curve.x is not None else ends
            axes.plot(ends, heights, "o", color="0.1", markersize=3, label=CLIFF)


def _lines(
    axes: Axes, record: Record, curves: Sequence[Curve], colour: str
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Abscissae and values of lines: the median of curves over time, with their band drawn; else each curve."""
    over_time = all(curve.x is None and len(curve.values) == len(record.time_s) for curve in curves)
    if len(curves) > 1 and over_time:
        values = np.stack([curve.values for curve in curves])
        axes.fill_between(record.time_s, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.25, linewidth=0)
        return [(record.time_s, np.asarray(np.median(values, axis=0)))]
    return [(record.time_s[: len(curve.values)] if curve.x is None else curve.x, curve.values) for curve in curves]


def _near(panel: Panel) -> bool:
    """Whether a curve comes near its limits; otherwise drawing these would make it small."""
    maximum = max(float(np.nanmax(np.abs(curve.values), initial=0.0)) for curve in panel.curves.values())
    return maximum > NEAR * max(map(abs, panel.limits), default=0.0)


def _name_regions(axes: Axes, regions: Regions | None) -> None:
    """Write the names of the three regions of figure 4.4 beside the curve, where there is room."""
    if regions is None:
        return
    low, high = axes.get_xlim()
    ends = (low, regions.cliff_from_s, regions.cliff_to_s, high)
    for (name, height), left, right in zip(REGIONS.items(), ends, ends[1:], strict=False):
        if right - left > NARROW * (high - low):
            middle, where = (left + right) / 2, axes.get_xaxis_transform()
            axes.text(middle, height, name, transform=where, fontsize="x-small", color="0.35", ha="center")


def _add_legend(canvas: Figure, grid: Sequence[Axes]) -> None:
    """Add one legend outside of all axes, each label once."""
    entries: dict[str, Artist] = {}
    for axes in grid:
        handles, labels = axes.get_legend_handles_labels()
        entries = dict(zip(labels, handles, strict=True)) | entries
    ordered = sorted(entries, key=(SETPOINT, LIMIT, CLIFF).__contains__)
    columns = max(1, min(len(entries), 5))
    canvas.legend(
        [entries[label] for label in ordered], ordered, loc="outside upper right", ncols=columns, fontsize="small",
        frameon=False,
    )  # fmt: skip


def _span(records: Sequence[Record]) -> tuple[float, float]:
    """First and last time of all records, s, the last frame included."""
    first, last = min(record.time_s[0] for record in records), max(record.time_s[-1] for record in records)
    frame = max(float(np.median(np.diff(record.time_s))) if len(record.time_ns) > 1 else 1e-3 for record in records)
    return float(first), float(last) + frame


def mark_events(grid: Sequence[Axes], record: Record) -> None:
    """Draw vertical lines at the events in all axes, with their kinds above the first."""
    for axes in grid:
        for time, _ in _events(record, 0.0):
            axes.axvline(time, color="0.6", linewidth=0.8, linestyle="--", zorder=1)
    for time, kinds in _events(record, NEARBY):
        grid[0].annotate(
            kinds.replace("_", " "), (time, 1.02), xycoords=("data", "axes fraction"), fontsize="x-small",
            color="0.35", ha="left", va="bottom",
        )  # fmt: skip


def _events(record: Record, nearby: float) -> list[tuple[float, str]]:
    """Time (s) and kind of events and trips within the record; those closer than `nearby` of its span are merged."""
    grouped: list[tuple[float, float, str]] = []
    span = record.time_s[-1] - record.time_s[0]
    events = [(event.time_ns / NANOSECONDS, str(event.kind)) for event in record.events]
    events += [(time, f"tripped: {cause}") for time, _, cause in trips(supervision(record))]
    for time, kind in sorted(events):
        if time > record.time_s[-1]:
            continue
        if grouped and time - grouped[-1][1] <= nearby * span:
            grouped[-1] = (grouped[-1][0], time, f"{grouped[-1][2]}, {kind}")
        else:
            grouped.append((time, time, kind))
    return [(first, kinds) for first, _, kinds in grouped]
