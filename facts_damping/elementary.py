"""Elementary functions of compiled code and of plain code, for now the C library's."""

from __future__ import annotations

import cmath
import math

from facts_damping.compiling import compiled


@compiled
def sin(x: float) -> float:
    """Sine of x, rad."""
    return math.sin(x)


@compiled
def cos(x: float) -> float:
    """Cosine of x, rad."""
    return math.cos(x)


@compiled
def sin_cos(x: float) -> tuple[float, float]:
    """Sine and cosine of x, rad."""
    return math.sin(x), math.cos(x)


@compiled
def tan(x: float) -> float:
    """Tangent of x, rad."""
    return math.tan(x)


@compiled
def exp(x: float) -> float:
    """e^x."""
    return math.exp(x)


@compiled
def expm1(x: float) -> float:
    """e^x - 1."""
    return math.expm1(x)


@compiled
def log(x: float) -> float:
    """Natural logarithm of x."""
    return math.log(x)


@compiled
def log1p(x: float) -> float:
    """Natural logarithm of 1 + x."""
    return math.log1p(x)


@compiled
def pow(x: float, y: float) -> float:  # noqa: A001 (as the C library calls it)
    """x^y."""
    return math.pow(x, y)


@compiled
def atan2(y: float, x: float) -> float:
    """Angle of x + j y, rad."""
    return math.atan2(y, x)


@compiled
def tanh(x: float) -> float:
    """Hyperbolic tangent of x."""
    return math.tanh(x)


@compiled
def hypot(x: float, y: float) -> float:
    """Root of x^2 + y^2."""
    return math.hypot(x, y)


@compiled
def phase(z: complex) -> float:
    """Angle of z, rad."""
    return math.atan2(z.imag, z.real)


@compiled
def exp_complex(z: complex) -> complex:
    """e^z."""
    return cmath.exp(z)


@compiled
def rect(r: float, phi: float) -> complex:
    """Number of magnitude r and angle phi, rad."""
    return complex(r * math.cos(phi), r * math.sin(phi))
