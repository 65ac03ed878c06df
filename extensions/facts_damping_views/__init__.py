"""Views of a run: the cockpit, a page in a browser; and for Foxglove and PlotJuggler."""
