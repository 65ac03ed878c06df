"""Sums and quotients of numbers that are given as two floats; compiled.

What of a result does not fit into its float is kept beside it, as by T. J. Dekker, A Floating-Point Technique for
Extending the Available Precision, Numerische Mathematik 18, 1971; products of floats of 26 bits are exact.
"""

from __future__ import annotations

import math

from facts_damping.compiling import bits_of, compiled, inlined, number_of

FIRST_26_BITS = -0x8000000  # of 53
NAN = math.nan  # one for all: what a processor makes of inf - inf differs in its sign
INF = math.inf


@inlined
def first_bits(x: float) -> float:
    """The first 26 bits of a number, cut."""
    return number_of(bits_of(x) & FIRST_26_BITS)  # type: ignore[no-any-return]


@inlined
def two_sum(a: float, b: float) -> tuple[float, float]:
    """A sum and what its rounding cut off."""
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@inlined
def quotient(n: float, n_low: float, d: float, d_low: float) -> tuple[float, float]:
    """(n + n_low) / (d + d_low) as 26 bits and the rest, to 75 bits or so."""
    over = 1.0 / d
    q = first_bits(n * over)
    d_first = first_bits(d)
    return q, (((n - q * d_first) - q * (d - d_first)) + (n_low - q * d_low)) * over


@compiled
def divided(z: complex, by: float) -> complex:
    """A complex number divided by a real one; compiled code would divide by a complex one, in twice the time."""
    return complex(z.real / by, z.imag / by)
