"""Sweeps: axes, runs in many processes, their tables and pictures."""
