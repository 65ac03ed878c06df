"""How the numerical kernels are compiled: parts, entry points, structs; files that cannot be stale."""

from facts_damping.compiling.kernels import branching, call_address, compiled, entry_point, inlined

__all__ = ["branching", "call_address", "compiled", "entry_point", "inlined"]
