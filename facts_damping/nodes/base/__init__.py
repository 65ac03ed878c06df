"""What all nodes share: parameters, log, QoS, discovery, waiting, start and end."""
