"""Elementwise arithmetic of complex numbers and arrays with the same bits on all processors.

NumPy has loops for processors with FMA, which adds a product without rounding it first, so its complex products and
magnitudes differ there. So do Python's own if its compiler used that instruction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.kernels import NUMERIC
from facts_damping.compiling.structs import Complex1, Float1
from facts_damping.elementary import exp_complex, magnitude, phase, rect

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SERIES = 1e-18  # relative to a sum: smaller terms do not change it


@compiled
def _product(a: complex, b: complex) -> complex:
    """`times` of two numbers; in Python with the same bits."""
    return complex(a.real * b.real - a.imag * b.imag, a.real * b.imag + a.imag * b.real)


@compiled
def _quotient(a: complex, b: complex) -> complex:
    """`over` of two numbers, scaled by the larger part of b. In Python with the same bits, except for 0 and NaN."""
    if abs(b.real) >= abs(b.imag):
        ratio = b.imag / b.real
        divisor = b.real + b.imag * ratio
        return complex((a.real + a.imag * ratio) / divisor, (a.imag - a.real * ratio) / divisor)
    ratio = b.real / b.imag
    divisor = b.real * ratio + b.imag
    return complex((a.real * ratio + a.imag) / divisor, (a.imag * ratio - a.real) / divisor)


@entry_point
def _times(a: Complex1, b: Complex1, out: Complex1) -> None:
    for i in range(out.size):
        out[i] = _product(a[i], b[i])


@entry_point
def _over(a: Complex1, b: Complex1, out: Complex1) -> None:
    for i in range(out.size):
        out[i] = _quotient(a[i], b[i])


@entry_point
def _magnitudes(z: Complex1, out: Float1) -> None:
    for i in range(out.size):
        out[i] = magnitude(z[i])


@entry_point
def _angles(z: Complex1, out: Float1) -> None:
    for i in range(out.size):
        out[i] = phase(z[i])


@entry_point
def _turned(size: Float1, angle: Float1, out: Complex1) -> None:
    for i in range(out.size):
        out[i] = rect(size[i], angle[i])


@entry_point
def _exponentials(z: Complex1, out: Complex1) -> None:
    for i in range(out.size):
        out[i] = exp_complex(z[i])


def _elementwise(kernel: Any, kind: Any, *operands: ArrayLike, of: Any = complex) -> NDArray[Any]:
    """Apply a kernel to arrays of one shape or broadcast to one."""
    arrays = [np.asarray(operand, of) for operand in operands]
    if any(array.shape != arrays[0].shape for array in arrays):
        whole = np.broadcast_shapes(*(array.shape for array in arrays))
        arrays = [np.broadcast_to(array, whole) for array in arrays]
    out = np.zeros(arrays[0].shape, kind)
    kernel(*(np.ascontiguousarray(array).reshape(-1) for array in arrays), out.reshape(-1))
    return out


def times(a: ArrayLike, b: ArrayLike) -> NDArray[np.complex128]:
    """Products a b."""
    if isinstance(a, NUMERIC) and isinstance(b, NUMERIC):  # frequent in setting up a grid: needs no kernel call
        return np.array(_product.py_func(complex(a), complex(b)))
    return _elementwise(_times, complex, a, b)


def over(a: ArrayLike, b: ArrayLike) -> NDArray[np.complex128]:
    """Quotients a / b."""
    if isinstance(a, NUMERIC) and isinstance(b, NUMERIC) and b == b != 0.0:  # noqa: PLR0124 (no NaN)
        return np.array(_quotient.py_func(complex(a), complex(b)))
    return _elementwise(_over, complex, a, b)


def magnitudes(z: ArrayLike) -> NDArray[np.float64]:
    """Magnitudes |z|."""
    return _elementwise(_magnitudes, float, z)


def angles(z: ArrayLike) -> NDArray[np.float64]:
    """Angles of z, rad, in (-pi, pi]."""
    return _elementwise(_angles, float, z)


def polar(size: ArrayLike, angle: ArrayLike) -> NDArray[np.complex128]:
    """Numbers r e^(j phi) of given magnitudes and angles, rad."""
    return _elementwise(_turned, complex, size, angle, of=float)


def exponentials(z: ArrayLike) -> NDArray[np.complex128]:
    """Exponentials e^z."""
    return _elementwise(_exponentials, complex, z)


def power(z: complex, n: int) -> complex:
    """The n-th power of z, n >= 0, by repeated squaring."""
    product, square = complex(1.0, 0.0), complex(z)
    while n > 0:
        if n % 2 == 1:
            product = _product(product, square)
        square = _product(square, square)
        n //= 2
    return product


@entry_point
def _line_factors(w: Complex1, out: Complex1) -> None:
    whole = half = even = complex(1.0, 0.0)  # sinh(g) / g, sinh(g / 2) / (g / 2), cosh(g / 2)
    term = half_term = even_term = complex(1.0, 0.0)
    k = 0
    while abs(term.real) + abs(term.imag) > SERIES * (abs(whole.real) + abs(whole.imag)):
        k += 1
        term = term * w[0] / ((2.0 * k) * (2.0 * k + 1.0))
        half_term = half_term * w[0] / (4.0 * (2.0 * k) * (2.0 * k + 1.0))
        even_term = even_term * w[0] / (4.0 * (2.0 * k) * (2.0 * k - 1.0))
        whole, half, even = whole + term, half + half_term, even + even_term
    out[0], out[1] = whole, half / even


def line_factors(w: complex) -> tuple[complex, complex]:
    """Factors sinh(g) / g and tanh(g / 2) / (g / 2) at w = g^2, by the series of sinh and cosh in w and w / 4."""
    out = np.zeros(2, complex)
    _line_factors(np.array([w], complex), out)
    return complex(out[0]), complex(out[1])
