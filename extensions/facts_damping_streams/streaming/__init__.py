"""Synchrophasor streams over the network: servers and clients of IEEE C37.118.2, without ROS."""
