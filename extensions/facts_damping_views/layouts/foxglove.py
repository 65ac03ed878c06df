"""Writes panels as a layout file of Foxglove: the JSON that the app exports and imports.

Paths use its message path syntax (docs.foxglove.dev/docs/visualization/message-path-syntax).
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from facts_damping_views.layouts.panels import DIAGNOSTICS, MESSAGE, PLOT, STATES, TABLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from facts_damping_views.layouts.panels import Curve, Panel, Tab

TYPES = {
    PLOT: "Plot",
    STATES: "StateTransitions",
    TABLE: "Table",
    MESSAGE: "RawMessages",
    DIAGNOSTICS: "DiagnosticSummary",
}


def foxglove_layout(tabs: Sequence[Tab]) -> str:
    """The layout file of some tabs."""
    panels: dict[str, Any] = {}
    shown = []
    for tab in tabs:
        names = []
        for panel in tab.panels:
            names.append(f"{TYPES[panel.kind]}!{len(panels)}")
            panels[names[-1]] = {"foxglovePanelTitle": panel.title, **_settings(panel)}
        rows = [_split(names[i : i + 2], "row") for i in range(0, len(names), 2)]
        shown.append({"title": tab.title, "layout": _split(rows, "column")})
    panels["Tab!tabs"] = {"activeTabIdx": 0, "tabs": shown}
    rest = {"globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1}, "layout": "Tab!tabs"}
    return json.dumps({"configById": panels, **rest}, indent=1, ensure_ascii=False) + "\n"


def path(curve: Curve) -> str:
    """A curve's message path."""
    return f"{curve.topic}.{curve.path}" if curve.path else curve.topic


def _settings(panel: Panel) -> dict[str, Any]:
    first_curve = panel.curves[0]
    if panel.kind == DIAGNOSTICS:
        return {
            "topicToRender": first_curve.topic,
            "minLevel": 0,
            "pinnedIds": [],
            "hardwareIdFilter": "",
            "sortByLevel": True,
        }
    if panel.kind in (TABLE, MESSAGE):
        return {"topicPath": path(first_curve)}
    paths = [
        {"value": path(curve), "label": curve.label, "enabled": True, "timestampMethod": "receiveTime"}
        for curve in panel.curves
    ]
    if panel.kind == STATES:
        return {"paths": paths, "isSynced": True}
    return {
        "paths": paths,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "isSynced": True,
        "xAxisVal": "timestamp",
        "sidebarDimension": 240,
    }


def _split(parts: list[Any], direction: str) -> Any:
    """Arrange parts of equal size side by side: Foxglove splits in two each time."""
    if len(parts) == 1:
        return parts[0]
    rest = _split(parts[1:], direction)
    return {"first": parts[0], "second": rest, "direction": direction, "splitPercentage": 100 / len(parts)}
