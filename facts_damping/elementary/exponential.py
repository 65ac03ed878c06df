"""Exponential, e^x - 1 and hyperbolic tangent; compiled.

e^x = 2^m 2^(j/128) e^r, |r| <= ln(2)/256, with 2^(j/128) from a table and Taylor's series of r (P. T. P. Tang,
Table-Driven Implementation of the Exponential Function, ACM Trans. Math. Software 15(2), 1989, and of the Expm1
Function, 18(2), 1992). ln(2)/128 is a sum of two floats, of which multiples of the first are exact (Cody, Waite 1980).
"""

from __future__ import annotations

import math

from facts_damping.compiling import bits_of, entry_point, inlined, number_of
from facts_damping.elementary.arithmetic import INF, first_bits, quotient
from facts_damping.elementary.tables import CELLS_PER_UNIT, OCTAVE_HIGH, OCTAVE_LOW, POWERS

WHOLE = 1.5 * 2.0**52  # added and subtracted, it rounds to whole numbers
WHOLE_BITS = 0x4338000000000000  # its bits: the difference to those of a sum is the whole number
NO_LOW = -0.0  # what changes nothing where it is added, not even the sign of a zero


@inlined
def _tail(r: float) -> float:
    """e^r - 1 - r, to 2^-60."""
    square = r * r
    return square * ((1.0 / 2.0 + r * (1.0 / 6.0)) + square * (1.0 / 24.0 + r * (1.0 / 120.0)))


@inlined
def exp_parts(x: float, x_low: float) -> tuple[float, float, float]:
    """e^(x + x_low) as (a + b) c: a float, the rest, and 1 or, where their sum may not be normal, a power of 2."""
    shift, scale = 0, 1.0
    if not abs(x) < 650.0:
        if not x < 752.0:
            return (INF, 0.0, 1.0) if x > 0.0 else (x, 0.0, 1.0)
        if x < -752.0:
            return 0.0, 0.0, 1.0
        shift, scale = (64, 2.0**64) if x > 0.0 else (-64, 2.0**-64)
    shifted = x * CELLS_PER_UNIT + WHOLE
    n = shifted - WHOLE
    r = ((x - n * OCTAVE_HIGH) - n * OCTAVE_LOW) + x_low
    k = bits_of(shifted) - WHOLE_BITS
    row = 4 * (k & 127)
    s = number_of(bits_of(POWERS[row]) + (((k >> 7) - shift) << 52))
    return s, s * (POWERS[row + 1] + (r + _tail(r))), scale


@inlined
def exp_sum(x: float, x_low: float) -> float:
    """e^(x + x_low)."""
    a, b, scale = exp_parts(x, x_low)
    return (a + b) * scale


@entry_point
def exp(x: float) -> float:
    """Exponential; within 0.51 ulp, 0.76 ulp where the result is subnormal."""
    return exp_sum(x, NO_LOW)


@inlined
def _expm1_parts(x: float) -> tuple[float, float]:
    """e^x - 1 as a float and the rest, -17 < x < 40.

    26 bits of the table times 26 bits of r are exact.
    """
    shifted = x * CELLS_PER_UNIT + WHOLE
    n = shifted - WHOLE
    t = n * OCTAVE_LOW
    y = x - n * OCTAVE_HIGH
    r = y - t
    r_low = (y - r) - t
    k = bits_of(shifted) - WHOLE_BITS
    row = 4 * (k & 127)
    scale = (k >> 7) << 52
    s = number_of(bits_of(POWERS[row + 2]) + scale)
    s_low = POWERS[row + 3] * number_of(0x3FF0000000000000 + scale)
    first = first_bits(r)
    square = r * r
    tail = _tail(r) + square * square * square * (1.0 / 720.0)  # to 2^-63 of r
    rest = (r - first) + (r_low + tail)
    below = s - 1.0
    product = s * first
    high = below + product
    return high, (((below - high) + product) + ((s - below) - 1.0)) + (s_low + (s * rest + s_low * (r + tail)))


@entry_point
def expm1(x: float) -> float:
    """e^x - 1; within 0.51 ulp, 0.54 ulp where 1 is nearly nothing beside e^x."""
    if abs(x) < 2.0**-54:
        return x
    if not abs(x - 12.0) < 28.0:  # below -16, or 1 is nothing beside the result, from 40 on
        if x < 40.0:
            if x < 0.0:
                return exp(x) - 1.0  # type: ignore[no-any-return]
        else:
            return exp(x)  # type: ignore[no-any-return]
    high, low = _expm1_parts(x)
    return high + low


@entry_point
def tanh(x: float) -> float:
    """Hyperbolic tangent, e / (e + 2) with e = e^(2|x|) - 1; within 0.52 ulp."""
    size = abs(x)
    if size < 2.0**-28:
        return x
    if not size < 20.0:
        return math.copysign(1.0, x) if x == x else x  # noqa: PLR0124 (NaN is not itself)
    high, low = _expm1_parts(2.0 * size)
    n = high + low
    d = n + 2.0
    # Of n and 2 the larger one may be either: the difference of the other one is exact.
    d_low = (2.0 - d) + n if n < 2.0 else (n - d) + 2.0
    q, q_low = quotient(n, (high - n) + low, d, d_low + ((high - n) + low))
    return math.copysign(q + q_low, x)
