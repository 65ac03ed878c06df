"""Nodes that listen to a graph and show it."""

from facts_damping.nodes.executables import entry_point

live_view = entry_point("facts_damping_views.nodes.live_view", computes=False)
cockpit = entry_point("facts_damping_views.nodes.cockpit", computes=False)
