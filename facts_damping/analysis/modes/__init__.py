"""Modes of a record: poles by several methods, with confidence intervals, and stability."""
