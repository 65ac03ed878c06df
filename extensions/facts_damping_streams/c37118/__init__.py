"""Encodes and decodes synchrophasor messages of IEEE C37.118.2-2011, without sockets and ROS.

`frame` has the common part of all messages, `configuration` the configuration frames, `data` the data frames.
"""
