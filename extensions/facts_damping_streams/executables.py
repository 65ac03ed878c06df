"""Entry points of `ros2 run facts_damping NODE` for the nodes of this package."""

from facts_damping.nodes.executables import entry_point

c37118_server = entry_point("facts_damping_streams.nodes.c37118_server")
c37118_client = entry_point("facts_damping_streams.nodes.c37118_client")
