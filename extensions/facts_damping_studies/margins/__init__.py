"""Delay margins: of the linear closed loop, and by runs."""
