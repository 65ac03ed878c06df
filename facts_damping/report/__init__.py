"""A report of recordings: one page of HTML that needs no network, side by side what the runs say.

`contents` is what it says, as plain data; `drawing` makes that into charts, `page` into a file.
"""

from facts_damping.report.page import write

__all__ = ["write"]
