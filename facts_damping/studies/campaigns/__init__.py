"""Fault campaigns: faults drawn, rules that must hold."""
