"""Picture of an oscillation's energy on the one-line diagram: where it comes from, where it goes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from facts_damping.output.picture_files import save_picture
from facts_damping_views.analysis.causes import Cause
from facts_damping_views.analysis.cells import ends
from facts_damping_views.analysis.locating import named, words
from facts_damping_views.bus_places import places

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from facts_damping.parameters.plant.system import System
    from facts_damping_views.analysis.locating import Location
    from facts_damping_views.bus_places import Places

SOURCE, SINK = "#D55E00", "#0072B2"
NAMED = 40  # buses, up to which all are labelled
MOST = 6  # labelled places in a large grid
SMALLEST = 0.01  # of the largest, below which a flow is not drawn
LARGEST_DOT, ARROW = 22.0, 0.14  # points; length of the largest arrow, relative to the picture


def plot(system: System, where: Location, path: Path) -> Path:
    """Draw it: dots of units that feed the oscillation or damp it, arrows of the flow at PMUs at buses."""
    at = places(system)
    width, height = np.ptp(np.array(list(at.values())), axis=0)
    figure = Figure(figsize=(10.0, 11.0) if height > 1.3 * width else (12.0, 9.0), layout="constrained")
    axes = figure.add_subplot()
    for a, b in ends(system).values():
        axes.plot(*np.transpose([at[a], at[b]]), color="0.8", lw=1.0, zorder=1)
    axes.plot(*np.transpose([at[bus.name] for bus in system.buses]), "o", color="0.5", ms=3, zorder=2)
    if len(system.buses) <= NAMED:
        for bus in system.buses:
            axes.annotate(bus.name, tuple(at[bus.name]), (3, 4), textcoords="offset points", fontsize=7, color="0.4")
    _arrows(axes, system, where, at)
    _units(axes, system, where, at)
    _source(axes, where, at)
    marks = [
        Line2D([], [], ls="", marker="o", color=SOURCE, label="feeds it"),
        Line2D([], [], ls="", marker="o", color=SINK, label="damps it"),
        Line2D([], [], color="black", marker=">", label="energy at a PMU"),
        Line2D([], [], ls="", marker="o", mfc="none", mec="black", ms=12, label="source"),
    ]
    figure.legend(handles=marks, loc="outside right center", fontsize=9, frameon=False)
    axes.set_aspect("equal")
    axes.margins(0.1)
    axes.set_axis_off()
    first = where.causes[0] if where.causes else where.places[0]
    source = named(first) if isinstance(first, Cause) else words(first.cell)
    title = f"energy of the oscillation of {where.frequency:.3f} Hz; source: {source}"
    title += f", first in {round(first.first * where.windows)} of {where.windows} windows"
    figure.suptitle(f"{system.name}: {title}", fontsize=11)
    return save_picture(figure, path, dpi=130)


def _units(axes: Axes, system: System, where: Location, at: Places) -> None:
    """Dots of units that a PMU tells apart, in size and colour by what they produce; labels of the largest."""
    alone = [p for p in where.places if len(p.cell.units) == 1 and not p.cell.loads]
    by_size = sorted(alone, key=lambda p: -abs(p.relative))
    named = {p.cell.units[0] for p in (by_size if len(system.buses) <= NAMED else by_size[:MOST])}
    for place in by_size:
        size = max(4.0, LARGEST_DOT * abs(place.relative) ** 0.5)
        colour, unit = SOURCE if place.relative > 0.0 else SINK, place.cell.units[0]
        axes.plot(*at[place.cell.bus], "o", ms=size, color=colour, alpha=0.7, zorder=4, mew=0)
        if unit in named:
            label = f"{unit} {place.relative:+.2f}"
            axes.annotate(label, tuple(at[place.cell.bus]), (12, -16), textcoords="offset points", fontsize=8, zorder=6)


def _arrows(axes: Axes, system: System, where: Location, at: Places) -> None:
    """Arrows of the flow at each PMU at a bus, along its branches, in the direction of the energy."""
    branches = ends(system)
    values = [abs(flow) for flow in where.flow if np.isfinite(flow)]
    largest, extent = max(values, default=0.0), float(np.ptp(np.array(list(at.values())), axis=0).max())
    for pmu, flow in zip(system.pmus, where.flow, strict=True):
        if pmu.bus is None or not abs(flow) > SMALLEST * largest:
            continue
        others = [at[bus] for name in pmu.branches for bus in branches[name] if bus != pmu.bus]
        along = np.mean(others, axis=0) - at[pmu.bus]
        length = max(float(np.hypot(*along)), 1e-9)
        reach = along / length * max(0.04, ARROW * (abs(flow) / largest) ** 0.5) * extent
        tail, head = (at[pmu.bus], at[pmu.bus] + reach) if flow > 0.0 else (at[pmu.bus] + reach, at[pmu.bus])
        look: dict[str, Any] = {"arrowstyle": "-|>", "color": "black", "lw": 1.0 + 2.5 * abs(flow) / largest}
        axes.annotate("", xy=tuple(head), xytext=tuple(tail), arrowprops=look, zorder=5, annotation_clip=False)


def _source(axes: Axes, where: Location, at: Places) -> None:
    """A ring around the source: its bus, or all that it may be at."""
    buses = where.causes[0].buses if where.causes else where.places[0].cell.buses or [where.places[0].cell.bus]
    for bus in buses:
        axes.plot(*at[bus], "o", ms=30.0 if len(buses) == 1 else 9.0, mfc="none", mec="black", mew=1.5, zorder=6)
