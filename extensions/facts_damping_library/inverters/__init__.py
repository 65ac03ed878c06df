"""Inverters, and their controls."""
