"""The ROS 2 nodes, kept thin: parameters, topics, and one short callback per topic."""
