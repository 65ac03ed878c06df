"""Sine, cosine and tangent; compiled.

An angle is x = j pi/64 + r, |r| <= pi/128: sin(x) = sin(j pi/64) cos(r) + cos(j pi/64) sin(r). Values of j are in a
table, those of r are Taylor's series (P. T. P. Tang, Table-Lookup Algorithms for Elementary Functions and Their Error
Analysis, ARITH 10, 1991). r must be exact to 2^-110, as no float is nearer than 2^-60 to a multiple of pi/2:

- below 4000, pi/64 is a sum of three floats, of which multiples of the first two are exact (W. J. Cody, W. Waite,
  Software Manual for the Elementary Functions, 1980);
- beyond, those digits of 2/pi are multiplied of which the product is no multiple of 4 and not too small (M. H. Payne,
  R. N. Hanek, Radian Reduction for Trigonometric Functions, SIGNUM Newsletter 18(1), 1983).
"""

from __future__ import annotations

from facts_damping.compiling import bits_of, compiled, entry_point, inlined, number_of
from facts_damping.elementary.arithmetic import NAN, first_bits, quotient, two_sum
from facts_damping.elementary.tables import (
    CELL_1,
    CELL_2,
    CELL_3,
    CELL_HIGH,
    CELL_LOW,
    CELLS_PER_RADIAN,
    SINES,
    TWO_OVER_PI,
)

WHOLE = 1.5 * 2.0**52  # added and subtracted, it rounds to whole numbers
NEAR = 4000.0
TINY = 2.0**-27  # sin(x) is x below
LIMB_MASK = 2**30 - 1
S3, S5, S7 = -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0
C2, C4, C6 = -1.0 / 2.0, 1.0 / 24.0, -1.0 / 720.0


@compiled
def _far(x: float) -> tuple[int, float, float]:
    """Return j, r and its rest for |x| from NEAR on, by digits to base 2^30.

    |x| = m 2^e; m times the digits of 2/pi gives x 2/pi modulo 4 at least, that is j modulo 128.
    """
    bits = bits_of(abs(x))
    if bits >= 0x7FF0000000000000:
        return 0, NAN, NAN
    e = (bits >> 52) - 1075
    m = (bits & 0xFFFFFFFFFFFFF) | 0x10000000000000
    low, high = m & LIMB_MASK, m >> 30
    first = (e + 58) // 30  # limbs before this one give multiples of 4
    carry, rest = 0, 0.0
    for i in range(first + 7, first + 3, -1):
        digit = carry + low * TWO_OVER_PI[i] + high * TWO_OVER_PI[i + 1]
        rest = (rest + float(digit & LIMB_MASK)) * 2.0**-30
        carry = digit >> 30
    d3 = carry + low * TWO_OVER_PI[first + 3] + high * TWO_OVER_PI[first + 4]
    d2 = (d3 >> 30) + low * TWO_OVER_PI[first + 2] + high * TWO_OVER_PI[first + 3]
    d1 = (d2 >> 30) + low * TWO_OVER_PI[first + 1] + high * TWO_OVER_PI[first + 2]
    d0 = (d1 >> 30) + low * TWO_OVER_PI[first] + high * TWO_OVER_PI[first + 1]
    top = (d0 & LIMB_MASK) << 30 | (d1 & LIMB_MASK)
    places = 53 - (e + 58 - 30 * first)  # of `top` after the point, in cells
    j = (top + (1 << (places - 1))) >> places
    # What is after the point, in units of 2^(-60 - places) cells, may cancel but for its last digits.
    a, b = two_sum(float(top - (j << places)) * 2.0**60, float(d2 & LIMB_MASK) * 2.0**30)
    a, c = two_sum(a, float(d3 & LIMB_MASK))
    a, d = two_sum(a, rest)
    unit = number_of((963 - places) << 52)
    a *= unit
    a_first, cell_first = first_bits(a), first_bits(CELL_HIGH)
    r = a * CELL_HIGH
    r_low = ((a_first * cell_first - r) + a_first * (CELL_HIGH - cell_first)) + (a - a_first) * CELL_HIGH
    r_low += a * CELL_LOW + (b + (c + d)) * unit * CELL_HIGH
    return (j, r, r_low) if x > 0.0 else (-j, -r, -r_low)


@inlined
def reduced(x: float) -> tuple[int, float, float]:
    """Return j up to whole turns, r and its rest: x = j pi/64 + r + r_low.

    The last bits of what is rounded by WHOLE are those of n, modulo 2^51.
    """
    if not abs(x) < NEAR:
        return _far(x)
    shifted = x * CELLS_PER_RADIAN + WHOLE
    n = shifted - WHOLE
    y = x - n * CELL_1
    t = n * CELL_2
    r = y - t
    return bits_of(shifted), r, ((y - r) - t) - n * CELL_3


@inlined
def series(r: float) -> tuple[float, float]:
    """Sin(r) - r and cos(r) - 1, |r| <= pi/128."""
    square = r * r
    return r * square * (S3 + square * (S5 + square * S7)), square * (C2 + square * (C4 + square * C6))


@inlined
def turned(j: int, r: float, r_low: float, sine: float, cosine: float) -> tuple[float, float]:
    """The sine of j pi/64 + r + r_low as a float and the rest, from the series of r; to 2^-58 of it.

    The first 26 bits of r times those of the table's cosine are exact.
    """
    row = 4 * (j & 127)
    s, s_low, c, c_low = SINES[row], SINES[row + 1], SINES[row + 2], SINES[row + 3]
    first = first_bits(r)
    rest = (r - first) + (r_low + sine)
    product = c * first
    high = s + product
    return high, ((s - high) + product) + (s_low + (c * rest + (c_low * (r + sine) + s * cosine)))


@entry_point
def sin(x: float) -> float:
    """Sine of an angle (rad); within 0.55 ulp, NaN where the angle is not finite."""
    if abs(x) < TINY:
        return x
    j, r, r_low = reduced(x)
    sine, cosine = series(r)
    high, low = turned(j, r, r_low, sine, cosine)
    return high + low


@entry_point
def cos(x: float) -> float:
    """Cosine of an angle (rad), as the sine a quarter turn further; within 0.55 ulp."""
    j, r, r_low = reduced(x)
    sine, cosine = series(r)
    high, low = turned(j + 32, r, r_low, sine, cosine)
    return high + low


@compiled
def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of an angle (rad), the bits of `sin` and `cos`."""
    j, r, r_low = reduced(x)
    sine, cosine = series(r)
    s, s_low = turned(j, r, r_low, sine, cosine)
    c, c_low = turned(j + 32, r, r_low, sine, cosine)
    return x if abs(x) < TINY else s + s_low, c + c_low


@entry_point
def tan(x: float) -> float:
    """Tangent of an angle (rad), sine over cosine; within 0.53 ulp."""
    if abs(x) < TINY:
        return x
    j, r, r_low = reduced(x)
    sine, cosine = series(r)
    s, s_low = turned(j, r, r_low, sine, cosine)
    c, c_low = turned(j + 32, r, r_low, sine, cosine)
    n, d = s + s_low, c + c_low
    q, q_low = quotient(n, (s - n) + s_low, d, (c - d) + c_low)
    return q + q_low
