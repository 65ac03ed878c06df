"""Damping controllers: what they are given, the table of kinds, the compiled step."""
