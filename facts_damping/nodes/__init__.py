"""The ROS 2 nodes, thin: parameters, wiring, one short callback a topic."""
