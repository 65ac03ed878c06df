"""Encoding and decoding of IEEE Std C37.118.2-2011 synchrophasor messages, without sockets and ROS.

`frame` has the common part of all messages, `configuration` the configuration frames, `data` the data frames.
"""
