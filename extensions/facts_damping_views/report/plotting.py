"""Charts and maps of a report as Bokeh figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from bokeh import models
from bokeh.models.annotations import ColorBar, Span
from bokeh.palettes import RdBu, interp_palette
from bokeh.plotting import figure

from facts_damping.analysis.plotting.plots import COLOURS
from facts_damping_views.report.contents import Chart, Maps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bokeh.models.renderers import DataRenderer

    from facts_damping_views.report.contents import Curve, Map, Panel, Report

HEIGHT, TALL = 240, 340  # pixels, of a panel among others, and of a chart's only panel
PALETTE = interp_palette(RdBu[11], 255)  # blue negative, red positive, as in the pictures of analyze --spwvd
GREY, LIMIT = "#777777", "#B00020"
WIDTHS = {"solid": 1.4, "dashed": 0.9}
TIME = "time"  # name of the range shared by all charts over time
DRESS: dict[str, Any] = {
    "sizing_mode": "stretch_width",
    "toolbar_location": "above",
    "tools": "",
    "background_fill_color": None,
    "border_fill_color": None,
    "min_border": 0,
    "outline_line_color": "#cccccc",
    "output_backend": "canvas",
}
Figure = figure  # the library's class name is lower-case


class _Shared(NamedTuple):
    """Shared by all figures: range of time, sources by run and abscissae, names of the runs."""

    time: models.Range1d
    sources: dict[tuple[int, bytes], models.ColumnDataSource]
    names: Sequence[str]
    events: Sequence[float]


def plot(report: Report) -> dict[str, list[tuple[str, Figure]]]:
    """Titles and figures of each chart and of each group of maps, by key."""
    items = [item for section in report.sections for item in section.items]
    spans = [
        (curve.x[0], curve.x[-1])
        for item in items
        if isinstance(item, Chart) and item.over_time
        for panel in item.panels
        for curve in panel.curves
        if len(curve.x)
    ]
    begin, end = (float(f(span)) for f, span in zip((np.min, np.max), np.array(spans or [(0.0, 1.0)]).T, strict=True))
    time = _range(begin, max(end, begin + 1e-3))
    time.name = TIME
    shared = _Shared(time, {}, report.names, [at for at, _ in report.events])
    figures: dict[str, list[tuple[str, Figure]]] = {}
    for item in items:
        if isinstance(item, Chart):
            figures[item.key] = [(panel.title, _panel(item, panel, shared)) for panel in item.panels]
        elif isinstance(item, Maps):
            figures[item.key] = [(distribution.title, _map(distribution, shared)) for distribution in item.maps]
    return figures


def _range(start: float, end: float) -> models.Range1d:
    return models.Range1d(start=start, end=end, bounds=(start, end))


def _panel(chart: Chart, panel: Panel, shared: _Shared) -> Figure:
    plot_area = figure(
        height=HEIGHT if len(chart.panels) > 1 else TALL,
        x_range=shared.time if chart.over_time else models.DataRange1d(),
        y_axis_type="log" if chart.logarithmic else "linear",
        window_axis="x" if chart.over_time else "none",
        x_axis_label=chart.x_label,
        y_axis_label=chart.y_label or panel.title,
        **DRESS,
    )
    renderers = [_curve(plot_area, curve, shared) for curve in panel.curves]
    if chart.words:
        plot_area.y_range = _range(-0.5, len(chart.words) - 0.5)
        plot_area.yaxis.ticker = list(range(len(chart.words)))
        plot_area.yaxis.major_label_overrides = dict(enumerate(chart.words))
    for level in panel.levels:
        plot_area.add_layout(Span(location=level, dimension="width", line_color=LIMIT, line_dash="dotted"))
    if chart.over_time:
        _mark_events(plot_area, shared)
    tips = [("", "$name"), (chart.x_label, "$x{0.000}"), (chart.y_label, "$y{0.00000}")]
    hover = models.HoverTool(renderers=renderers, tooltips=tips)
    _equip(plot_area, hover, "width" if chart.over_time else "both")
    return plot_area


def _curve(figure: Figure, curve: Curve, shared: _Shared) -> DataRenderer:
    """One curve; curves of a run over the same x share a source."""
    key = curve.run, curve.x.tobytes()
    source = shared.sources.setdefault(key, models.ColumnDataSource({"x": curve.x}))
    column = f"y{len(source.data)}"
    source.data[column] = curve.y.astype(np.float32)
    name = shared.names[curve.run] + (f": {curve.name}" if curve.name else "")
    look: dict[str, Any] = {"name": name, "color": COLOURS[curve.run % len(COLOURS)], "source": source}
    renderer: DataRenderer
    if curve.style == "points":
        renderer = figure.scatter("x", column, size=8, line_width=2, fill_color=None, **look)
    else:
        renderer = figure.line("x", column, line_dash=curve.style, line_width=WIDTHS[curve.style], **look)
    renderer.tags = [f"run-{curve.run}"]  # the page hides a run by this tag
    return renderer


def _map(distribution: Map, shared: _Shared) -> Figure:
    first, last, low, high = distribution.extent
    labels: dict[str, Any] = {"x_axis_label": "t [s]", "y_axis_label": "f [Hz]"}
    plot_area = figure(height=TALL, x_range=shared.time, y_range=_range(low, high), **labels, **DRESS)
    largest = float(np.abs(distribution.values).max()) or 1.0
    colours = models.LinearColorMapper(palette=PALETTE, low=-largest, high=largest)
    area, name = (first, low, last - first, high - low), shared.names[distribution.run]
    image = plot_area.image([distribution.values], *area, color_mapper=colours, name=name)
    image.tags = [f"run-{distribution.run}"]
    plot_area.add_layout(ColorBar(color_mapper=colours, width=10, title=None, background_fill_color=None), "right")
    for line in distribution.lines:
        plot_area.add_layout(
            Span(location=line, dimension="width", line_color="black", line_dash="dashed", line_width=0.8)
        )
    _mark_events(plot_area, shared)
    tips = [("t [s]", "$x{0.0}"), ("f [Hz]", "$y{0.000}"), (f"W [{distribution.unit}]", "@image")]
    _equip(plot_area, models.HoverTool(renderers=[image], tooltips=tips), "both")
    return plot_area


def _mark_events(figure: Figure, shared: _Shared) -> None:
    for at in shared.events:
        figure.add_layout(Span(location=at, dimension="height", line_color=GREY, line_dash="dashed", line_width=1))


def _equip(figure: Figure, hover: models.HoverTool, zoomed: Literal["width", "both"]) -> None:
    """Add tools: drag zooms; wheel zoom and pan are off at first, so that the page scrolls over the figure."""
    zoom = models.BoxZoomTool(dimensions=zoomed)
    figure.add_tools(zoom, models.PanTool(), models.WheelZoomTool(dimensions=zoomed), models.ResetTool(), hover)
    figure.toolbar.active_drag = zoom
    figure.toolbar.active_scroll = None
    figure.toolbar.logo = None
    figure.axis.axis_label_text_font_style = "normal"
    figure.axis.axis_label_text_font_size = figure.axis.major_label_text_font_size = "12px"
    figure.grid.grid_line_color = "#e8e8e8"
