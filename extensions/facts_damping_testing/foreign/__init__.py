"""Nodes and messages that are not of the graph, for storms and tests of refusals."""
