"""Inverters: sources in the network with controls that are tables of blocks."""
