"""Faults at inverters behind a weak grid: whether any run ends by numerics, and which lose their synchronism."""
