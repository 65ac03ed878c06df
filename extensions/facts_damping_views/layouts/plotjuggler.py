"""Writes panels as a layout file of PlotJuggler 3: the XML that it saves and loads.

It shows only numbers over time, so texts, tables and entries without a fixed place in their message are left out. Field
names follow its parser of ROS messages (rosx_introspection, as in PlotJuggler 3.17): topic, then the fields, separated
by `/`, array indices as `[0]`. Diagnostics have special names: topic, node, key.
"""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from facts_damping_views.layouts.panels import DEADLINE_MISSES, PLOT, STATES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_views.layouts.panels import Curve, Panel, Tab

COLOURS = ("#1f77b4", "#d62728", "#1ac938", "#ff7f0e", "#f14cc1", "#9467bd", "#17becf", "#bcbd22")
STYLES = {PLOT: "Lines", STATES: "Steps"}


def plotjuggler_layout(tabs: Sequence[Tab]) -> str:
    """The layout file of some tabs."""
    root = Element("root")
    window = SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for tab in tabs:
        panels = [panel for panel in tab.panels if panel.kind in STYLES and any(map(name, panel.curves))]
        if panels:
            container = SubElement(SubElement(window, "Tab", tab_name=tab.title, containers="1"), "Container")
            rows = [panels[i : i + 2] for i in range(0, len(panels), 2)]
            column = _splitter(container, "-", len(rows))
            for row in rows:
                across = column if len(row) == 1 else _splitter(column, "|", len(row))
                for panel in row:
                    _plot(across, panel)
    SubElement(window, "currentTabIndex", index="0")
    SubElement(root, "use_relative_time_offset", enabled="1")
    for empty in ("Plugins", "customMathEquations", "snippets"):
        SubElement(root, empty)
    indent(root, " ")
    return "<?xml version='1.0' encoding='UTF-8'?>\n" + tostring(root, encoding="unicode") + "\n"


def name(curve: Curve) -> str:
    """Name of a curve; empty if it has none."""
    if curve.path == DEADLINE_MISSES:
        return f"{curve.topic}/{curve.label}/deadline_misses"
    if not curve.number or "{" in curve.path:
        return ""
    return f"{curve.topic}/{curve.path.replace('.', '/')}"


def _splitter(parent: Element, orientation: str, count: int) -> Element:
    """An evenly divided area: `-` one below the other, `|` side by side."""
    sizes = ";".join([f"{1 / count:.6g}"] * count)
    return SubElement(parent, "DockSplitter", orientation=orientation, sizes=sizes, count=str(count))


def _plot(parent: Element, panel: Panel) -> None:
    area = SubElement(parent, "DockArea", name=panel.title)
    plot = SubElement(
        area, "plot", mode="TimeSeries", style=STYLES[panel.kind], line_width="1.0", flip_x="false", flip_y="false"
    )
    SubElement(plot, "limitY")
    colours = cycle(COLOURS)
    for curve in filter(name, panel.curves):
        SubElement(plot, "curve", name=name(curve), color=next(colours))
