"""Evaluates records: a record in, figures out. It depends on neither plant nor ROS.

Plots are separate, in `facts_damping.analysis.plotting.plots`: loading Matplotlib takes longer than a run.
"""

from facts_damping.analysis.summary import summarise
from facts_damping.analysis.summary_table import table

__all__ = ["summarise", "table"]
