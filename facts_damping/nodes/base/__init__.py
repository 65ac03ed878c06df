"""Common parts of all nodes: parameters, log, QoS, discovery, spinner, start and end."""
