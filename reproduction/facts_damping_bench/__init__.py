"""Beside other programs: the same case by each, at equal error; ticks a second beside another co-simulation."""
