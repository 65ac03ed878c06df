"""Compiles the numerical kernels: parts, entry points, structs, and a cache of compiled files."""

from facts_damping.compiling.kernels import bits_of, branching, call_address, compiled, entry_point, inlined, number_of

__all__ = ["bits_of", "branching", "call_address", "compiled", "entry_point", "inlined", "number_of"]
