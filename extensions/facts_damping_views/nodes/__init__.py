"""Nodes that listen to a graph and show it."""
