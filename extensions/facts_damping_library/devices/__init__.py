"""Devices beside those of the core: a file per kind, which entry points add to the table of devices."""
