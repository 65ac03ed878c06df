"""Numerical methods with the same bits everywhere: matrices, phasors, tables of random draws."""
