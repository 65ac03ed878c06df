"""Devices that controllers command: a file for each kind, with its fields, its equations and its row."""
