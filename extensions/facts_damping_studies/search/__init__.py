"""Searches: structures and parameters of controllers, scored on training cases."""
