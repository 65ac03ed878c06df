"""What a record says about the control: records in, figures out. Knows neither plant nor ROS.

Plots are in `facts_damping.analysis.plotting.plots`, apart, because loading Matplotlib takes longer than a run.
"""

from facts_damping.analysis.summary import summarise, table

__all__ = ["summarise", "table"]
