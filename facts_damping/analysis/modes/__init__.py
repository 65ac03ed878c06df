"""Modes of a record: poles by several methods, with confidence; whether it is damped."""
