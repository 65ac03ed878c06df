"""What to look at in a run or a recording: layouts for Foxglove and PlotJuggler, made from the names in a case."""

from facts_damping.views.layouts import layouts

__all__ = ["layouts"]
