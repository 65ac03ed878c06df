"""Graphs as processes: start, watch, end."""
