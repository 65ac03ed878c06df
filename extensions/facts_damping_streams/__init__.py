"""Synchrophasor streams of IEEE C37.118.2: the protocol, servers and clients, their nodes and commands."""
