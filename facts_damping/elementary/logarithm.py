"""Logarithm, ln(1 + x) and power; compiled.

x = 2^k z: ln(x) = k ln(2) - ln(c) + ln(1 + r), r = z c - 1, with c, about 1/z, and ln(c) from a table and Taylor's
series of r (P. T. P. Tang, Table-Driven Implementation of the Logarithm Function, ACM Trans. Math. Software 16(4),
1990). c has 12 bits, so that the products of both halves of z are exact; k ln(2) - ln(c) is exact but for a small rest.
"""

from __future__ import annotations

from facts_damping.compiling import bits_of, entry_point, inlined, number_of
from facts_damping.elementary.arithmetic import FIRST_26_BITS, INF, NAN, first_bits, two_sum
from facts_damping.elementary.exponential import exp_sum
from facts_damping.elementary.tables import LN2_HIGH, LN2_LOW, LOGARITHMS, LOWEST

NORMAL = 2.0**-1022  # the least number of 53 bits
HALF = 0x4000000  # of the last one of the first 26 bits
UPPER = -(2**52)  # bits of sign and exponent


@inlined
def _cell(x: float, x_low: float, k: int) -> tuple[float, float, float, float]:
    """Return what sums up to ln(2^k (x + x_low)), x normal: n ln(2) - ln(c) and z c - 1, each as a float and the rest.

    The rest of the second one is below half a unit of the first one, or the first one is zero.
    """
    bits = bits_of(x)
    above = bits - LOWEST
    z = number_of(bits - (above & UPPER))
    row = 3 * ((above >> 45) & 127)
    n = float((above >> 52) + k)
    c = LOGARITHMS[row]
    first = number_of((bits_of(z) + HALF) & FIRST_26_BITS)  # rounded: 1 for what is near 1
    low = (z - first) * c
    if x_low != 0.0:
        low += x_low * number_of(0x3FF0000000000000 - (above & UPPER)) * c
    return n * LN2_HIGH + LOGARITHMS[row + 1], n * LN2_LOW + LOGARITHMS[row + 2], first * c - 1.0, low


@inlined
def _tail(r: float) -> float:
    """ln(1 + r) - r, to 2^-59 of r."""
    square = r * r
    return square * (
        (r * (1.0 / 3.0) - 0.5) + square * ((r * (1.0 / 5.0) - 0.25) + square * (r * (1.0 / 7.0) - 1.0 / 6.0))
    )


@inlined
def _long_tail(r: float) -> float:
    """ln(1 + r) - r + r^2/2, to 2^-73 of r."""
    square = r * r
    upper = (1.0 / 7.0 - r * (1.0 / 8.0)) + square * (1.0 / 9.0)
    return r * square * ((1.0 / 3.0 - r * 0.25) + square * ((1.0 / 5.0 - r * (1.0 / 6.0)) + square * upper))


@inlined
def _sum(base: float, base_low: float, first: float, rest: float) -> float:
    """Base + ln(1 + first + rest)."""
    r = first + rest
    high = base + first
    return high + (((base - high) + first) + (base_low + (rest + _tail(r))))


@entry_point
def log(x: float) -> float:
    """Natural logarithm; within 0.52 ulp, nearer to 1 than 1e-7 within 0.76 ulp.

    -inf of 0, NaN of what is negative.
    """
    k = 0
    if not NORMAL <= x < INF:
        if not x > 0.0:
            return -INF if x == 0.0 else NAN
        if x == INF:
            return x
        x, k = x * 2.0**54, -54
    base, base_low, first, rest = _cell(x, 0.0, k)
    return _sum(base, base_low, first, rest)


@entry_point
def log1p(x: float) -> float:
    """ln(1 + x); within 0.53 ulp."""
    if abs(x) < 2.0**-9:  # in the cell around 1, r is x
        return x + _tail(x) if abs(x) >= 2.0**-54 else x
    if not -1.0 < x < INF:
        return x if x == INF else -INF if x == -1.0 else NAN
    total, low = two_sum(1.0, x)
    base, base_low, first, rest = _cell(total, low if x < 2.0**60 else 0.0, 0)
    return _sum(base, base_low, first, rest)


@entry_point
def power(x: float, y: float) -> float:
    """x^y = e^(y ln(x)), with ln(x) to 2^-69 of it; within 0.53 ulp, 0.77 ulp where the result is subnormal.

    Where x^y has no value or is infinite: as `pow` of C.
    """
    size, power_size, sign, k = x, abs(y), 1.0, 0
    if not (NORMAL <= x < INF and 2.0**-66 < power_size < 2.0**64):
        if y == 0.0 or x == 1.0:
            return 1.0
        if x != x or y != y:  # noqa: PLR0124 (NaN is not itself)
            return NAN
        size = abs(x)
        if bits_of(x) < 0 and power_size < 2.0**53:  # numbers beyond are even
            n = int(power_size)
            if float(n) != power_size:
                if 0.0 < size < INF:
                    return NAN
            elif n & 1:
                sign = -1.0
        if not 0.0 < size < INF:
            return sign * (INF if (size > 1.0) == (y > 0.0) else 0.0)
        if not 2.0**-66 < power_size < 2.0**64:
            if power_size < 1.0 or size == 1.0:
                return sign
            return INF if (size > 1.0) == (y > 0.0) else 0.0
        if size < NORMAL:
            size, k = size * 2.0**54, -54
    base, base_low, first, rest = _cell(size, 0.0, k)
    r, r_low = two_sum(first, rest)
    r_first = first_bits(r)
    square = 0.5 * r_first * r_first  # exact; the rest of r^2/2 is (r - r_first) (r + r_first) / 2
    a = base + r
    b = a - square
    low = ((base - a) + r) + ((a - b) - square)
    low += (r_low + base_low) + (_long_tail(r) - 0.5 * (r - r_first) * (r + r_first))
    high = b + low
    low = (b - high) + low
    product = y * high
    y_first, high_first = first_bits(y), first_bits(high)
    y_rest, high_rest = y - y_first, high - high_first
    error = ((y_first * high_first - product) + y_first * high_rest + y_rest * high_first) + y_rest * high_rest
    return sign * exp_sum(product, error + y * low)
