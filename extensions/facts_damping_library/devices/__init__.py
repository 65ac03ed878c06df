"""Devices as in the PSS/E library: a file per kind, which entry points add to the table of devices."""
