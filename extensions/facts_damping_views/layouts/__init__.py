"""Layouts for Foxglove and PlotJuggler for a run or recording, made from the names in a case."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping_views.layouts.foxglove import foxglove_layout
from facts_damping_views.layouts.panels import tabs
from facts_damping_views.layouts.plotjuggler import plotjuggler_layout

if TYPE_CHECKING:
    from facts_damping.case.model import Case

__all__ = ["layouts"]


def layouts(case: Case, namespace: str = "/") -> dict[str, str]:
    """Text of each layout file by its name; `namespace`: of the graph."""
    all_tabs = tabs(case, namespace)
    return {"foxglove.json": foxglove_layout(all_tabs), "plotjuggler.xml": plotjuggler_layout(all_tabs)}
