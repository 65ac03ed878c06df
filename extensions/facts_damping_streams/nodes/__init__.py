"""Nodes that publish streams as PMU data frames, and send PMU data frames as streams."""
