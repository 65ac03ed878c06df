"""Fault campaigns: random faults, and invariants that must hold."""
