"""The layout files of a case."""

from __future__ import annotations

from typing import TYPE_CHECKING

from facts_damping.views import foxglove, plotjuggler
from facts_damping.views.panels import tabs

if TYPE_CHECKING:
    from facts_damping.case.model import Case


def layouts(case: Case, namespace: str = "/") -> dict[str, str]:
    """Text of each layout file by its name; `namespace`: of the graph."""
    found = tabs(case, namespace)
    return {"foxglove.json": foxglove.foxglove_layout(found), "plotjuggler.xml": plotjuggler.plotjuggler_layout(found)}
