"""How the numerical kernels are compiled: parts, entry points, structs; files that cannot be stale."""

from facts_damping.compiling.kernels import (
    bits_of,
    branching,
    call_address,
    compiled,
    entry_point,
    inlined,
    number_of,
)

__all__ = ["bits_of", "branching", "call_address", "compiled", "entry_point", "inlined", "number_of"]
