"""Layouts for Foxglove and PlotJuggler for a run or recording, made from the names in a case."""

from facts_damping.views.layouts import layouts

__all__ = ["layouts"]
