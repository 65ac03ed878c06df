"""Wide-area damping of power systems with FACTS devices, as a ROS 2 node graph."""

__version__ = "0.1.0"
