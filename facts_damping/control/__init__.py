"""Damping controllers: their inputs, the table of kinds, the compiled step."""
