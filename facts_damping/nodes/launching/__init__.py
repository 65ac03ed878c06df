"""Graphs as processes: start, supervision, fault injection, end."""
