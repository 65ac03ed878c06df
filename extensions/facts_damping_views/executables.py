"""Entry points of `ros2 run facts_damping NODE` for the nodes of this package."""

from facts_damping.nodes.executables import entry_point

live_view = entry_point("facts_damping_views.nodes.live_view", computes=False)
cockpit = entry_point("facts_damping_views.nodes.cockpit", computes=False)
