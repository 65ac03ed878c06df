"""Nodes that publish streams as PMU data frames, and send PMU data frames as streams."""

from facts_damping.nodes.executables import entry_point

c37118_server = entry_point("facts_damping_streams.nodes.c37118_server")
c37118_client = entry_point("facts_damping_streams.nodes.c37118_client")
