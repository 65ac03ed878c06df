"""Channels of frames, by their index."""

VOLTAGE, ANGLE, FREQUENCY, ACTIVE, REACTIVE = range(5)
