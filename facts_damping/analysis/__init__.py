"""What a record says about the control: records in, figures out. Knows neither plant nor ROS."""

from facts_damping.analysis.plots import plot_comparison, plot_record
from facts_damping.analysis.summary import summarise, table

__all__ = ["plot_comparison", "plot_record", "summarise", "table"]
