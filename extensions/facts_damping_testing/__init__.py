"""Graphs of nodes in one process, and storms: such graphs under random faults, judged by rules."""
