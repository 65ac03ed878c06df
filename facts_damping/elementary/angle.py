"""Angle and magnitude of a point in the plane, and complex numbers from them; compiled.

With t = y/x and j the nearest whole number to 64 t, atan(t) = atan(c) + atan((y - c x) / (x + c y)), c = j/64, from a
table and Taylor's series (P. T. P. Tang, Table-Lookup Algorithms for Elementary Functions and Their Error Analysis,
ARITH 10, 1991; J.-M. Muller, Elementary Functions, 2016, 6). Roots are corrected by their remainder (same, 5).
"""

from __future__ import annotations

import math

from facts_damping.compiling import bits_of, compiled, entry_point, inlined
from facts_damping.elementary.arithmetic import INF, NAN, first_bits, quotient
from facts_damping.elementary.circular import TINY, reduced, series, turned
from facts_damping.elementary.exponential import NO_LOW, exp_parts
from facts_damping.elementary.tables import ANGLES, PI_HIGH, PI_LOW

LARGE, SMALL = 2.0**500, 2.0**-400  # squares and products of numbers between are normal
NORMAL = 2.0**-900  # of a sum of squares above, what is below normal counts for nothing


@entry_point
def atan2(y: float, x: float) -> float:
    """Angle of the point (x, y), rad, -pi to pi; within 0.55 ulp.

    Signs of zeros, and what is infinite, as `atan2` of C.
    """
    n, d = abs(y), abs(x)
    base, base_low, sign = 0.0, 0.0, 1.0
    if bits_of(x) < 0:
        base, base_low, sign = PI_HIGH, PI_LOW, -1.0
    if n > d:
        n, d = d, n
        base, base_low, sign = 0.5 * PI_HIGH, 0.5 * PI_LOW, -sign
    if not SMALL < d < LARGE:
        if x != x or y != y:  # noqa: PLR0124 (NaN is not itself)
            return NAN
        if n == d:  # both zero, both infinite
            n, d = (0.0, 1.0) if d == 0.0 else (1.0, 1.0)
        elif d == INF:
            n, d = n * 0.0, 1.0
        else:
            scale = 2.0**-600 if d > 1.0 else 2.0**600
            n, d = n * scale, d * scale
    t = n / d
    if not t >= 2.0**-28:
        if t != t:  # noqa: PLR0124 (NaN is not itself)
            return NAN
        # A quotient that may be subnormal is that of the numbers as they are given.
        small = abs(y) / abs(x) if base == 0.0 and y != 0.0 else t
        return math.copysign(base + (base_low + sign * small), y)
    j = int(64.0 * t + 0.5)
    c = 0.015625 * float(j)
    d_first, n_first = first_bits(d), first_bits(n)
    a = n - c * d_first  # exact, as the product is
    b = c * (d - d_first)
    across = a - b
    along = d + c * n
    along_low = ((d - along) + c * n_first) + c * (n - n_first)
    u, u_low = quotient(across, (a - across) - b, along, along_low)
    r = u + u_low
    square = r * r
    tail = r * square * (-1.0 / 3.0 + square * (1.0 / 5.0 + square * (-1.0 / 7.0)))
    step, turn = sign * ANGLES[2 * j], sign * u
    first = base + step
    second = first + turn
    low = ((base - first) + step) + ((first - second) + turn)
    return math.copysign(second + (low + (base_low + sign * (ANGLES[2 * j + 1] + (u_low + tail)))), y)


@entry_point
def hypot(x: float, y: float) -> float:
    """Magnitude of the point (x, y), sqrt(x^2 + y^2); within 0.51 ulp, 0.76 ulp where it is subnormal.

    Infinite where a coordinate is.
    """
    a, b = max(abs(x), abs(y)), min(abs(x), abs(y))
    if x != x or y != y:  # noqa: PLR0124 (NaN is not itself)
        return INF if abs(x) == INF or abs(y) == INF else NAN
    scale = 1.0
    if not (b > SMALL and a < LARGE):
        if a == INF or b == 0.0 or b < a * 2.0**-54:
            return a
        scale = 2.0**600 if a > 1.0 else 2.0**-600
        a, b = a / scale, b / scale
    root = math.sqrt(a * a + b * b)
    a_first, b_first, first = first_bits(a), first_bits(b), first_bits(root)
    rest = ((a_first * a_first - first * first) + b_first * b_first) + (
        (a - a_first) * (a + a_first) + (b - b_first) * (b + b_first)
    )
    return (first + rest / (root + first)) * scale


@compiled
def magnitude(z: complex) -> float:
    """Magnitude of a complex number; within 1.23 ulp, as `hypot` where the square is near what is not normal.

    The plain formula (A. Ziv, Sharp ULP Rounding Error Bound for the Hypotenuse Function, Math. Comp. 68, 1999): a
    network takes millions of them a second.
    """
    square = z.real * z.real + z.imag * z.imag
    return math.sqrt(square) if NORMAL < square < INF else hypot(z.real, z.imag)


@compiled
def phase(z: complex) -> float:
    """Angle of a complex number, rad, -pi to pi; within 0.55 ulp."""
    return atan2(z.imag, z.real)  # type: ignore[no-any-return]


@inlined
def _times(r: float, r_low: float, high: float, low: float, scale: float) -> float:
    """(r + r_low) (high + low) scale, and its sign also where that is zero."""
    s, first = high + low, first_bits(r)
    s_first = first_bits(s)
    rest = (r - first) * s_first + (r * ((high - s_first) + low) + r_low * s)
    return math.copysign((first * s_first + rest) * scale, r * s)


@inlined
def _polar(r: float, r_low: float, scale: float, phi: float) -> complex:
    """(r + r_low) scale e^(i phi)."""
    j, rest, rest_low = reduced(phi)
    sine, cosine = series(rest)
    s, s_low = turned(j, rest, rest_low, sine, cosine)
    c, c_low = turned(j + 32, rest, rest_low, sine, cosine)
    s_scale = scale
    if abs(phi) < TINY:
        s, s_low = phi, 0.0
        if abs(phi) < 2.0**-300:  # products of parts stay normal
            s, s_scale = phi * 2.0**300, scale * 2.0**-300
    if not 0.0 < abs(r) < INF or phi == 0.0:
        return complex(r * scale * c, r * scale * (phi if phi == 0.0 else s))
    return complex(_times(r, r_low, c, c_low, scale), _times(r, r_low, s, s_low, s_scale))


@compiled
def rect(r: float, phi: float) -> complex:
    """The complex number of a magnitude and an angle (rad), r (cos(phi) + i sin(phi)).

    Each part within 0.55 ulp, 0.77 ulp where it is subnormal.
    """
    scale = 1.0
    if not SMALL < abs(r) < LARGE:
        scale = 2.0**400 if abs(r) > 1.0 else 2.0**-400
    return _polar(r / scale, 0.0, scale, phi)


@compiled
def exp_complex(z: complex) -> complex:
    """e^z = e^x (cos(y) + i sin(y)), z = x + i y; each part within 0.55 ulp, 0.77 ulp where it is subnormal.

    Where e^z is infinite or has no value: as `cexp` of C, but infinite in both parts from x = 752 on.
    """
    r, r_low, scale = exp_parts(z.real, NO_LOW)
    if z.imag == 0.0:
        return complex((r + r_low) * scale, z.imag)
    if not abs(z.imag) < INF:
        return (
            complex(0.0, math.copysign(0.0, z.imag)) if z.real == -INF else complex(INF if z.real == INF else NAN, NAN)
        )
    return _polar(r, r_low, scale, z.imag)
