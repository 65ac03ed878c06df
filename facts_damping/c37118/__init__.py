"""Messages of IEEE Std C37.118.2-2011, synchrophasors on the wire: to bytes and back, without sockets and ROS.

`frame` has what all messages share, `configuration` what PMUs say of themselves, `data` what they measure.
"""
