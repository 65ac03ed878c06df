"""A report of recordings: one HTML page, usable offline, that compares runs side by side.

`contents` defines it as plain data; `plotting` makes the charts, `page` the file.
"""

from facts_damping_views.report.contents import ReportedRun
from facts_damping_views.report.page import write, write_runs

__all__ = ["ReportedRun", "write", "write_runs"]
