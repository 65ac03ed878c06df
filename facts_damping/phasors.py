"""Arithmetic of complex numbers and arrays, elementwise, whose bits no processor chooses.

NumPy has loops for processors with FMA, in which a product is added to another one without being rounded before: so its
complex products and magnitudes are others there. So are Python's own where its compiler had that instruction for all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled
from facts_damping.elementary import exp_complex, hypot, phase, rect

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SERIES = 1e-18  # of a sum: terms below it change nothing


@compiled
def _times(a: NDArray[Any], b: NDArray[Any], out: NDArray[Any]) -> None:
    """Products."""
    for i in range(out.size):
        out[i] = a[i] * b[i]


@compiled
def _over(a: NDArray[Any], b: NDArray[Any], out: NDArray[Any]) -> None:
    """Quotients."""
    for i in range(out.size):
        out[i] = a[i] / b[i]


@compiled
def _magnitudes(z: NDArray[Any], out: NDArray[np.float64]) -> None:
    """Magnitudes."""
    for i in range(out.size):
        out[i] = hypot(z[i].real, z[i].imag)


@compiled
def _angles(z: NDArray[Any], out: NDArray[np.float64]) -> None:
    """Angles, rad."""
    for i in range(out.size):
        out[i] = phase(z[i])


@compiled
def _turned(size: NDArray[np.float64], angle: NDArray[np.float64], out: NDArray[np.complex128]) -> None:
    """Numbers of magnitudes and angles, rad."""
    for i in range(out.size):
        out[i] = rect(size[i], angle[i])


@compiled
def _exponentials(z: NDArray[np.complex128], out: NDArray[np.complex128]) -> None:
    """e^z."""
    for i in range(out.size):
        out[i] = exp_complex(z[i])


def _elementwise(kernel: Any, kind: Any, *given: ArrayLike, of: Any = complex) -> NDArray[Any]:
    """What a kernel makes of arrays of one shape, or that are broadcast to one."""
    arrays = np.broadcast_arrays(*(np.asarray(one, of) for one in given))
    out = np.zeros(arrays[0].shape, kind)
    kernel(*(np.ascontiguousarray(one).reshape(-1) for one in arrays), out.reshape(-1))
    return out


def times(a: ArrayLike, b: ArrayLike) -> NDArray[np.complex128]:
    """Products a b."""
    return _elementwise(_times, complex, a, b)


def over(a: ArrayLike, b: ArrayLike) -> NDArray[np.complex128]:
    """Quotients a / b."""
    return _elementwise(_over, complex, a, b)


def magnitudes(z: ArrayLike) -> NDArray[np.float64]:
    """Magnitudes |z|."""
    return _elementwise(_magnitudes, float, z)


def angles(z: ArrayLike) -> NDArray[np.float64]:
    """Angles of z, rad, in (-pi, pi]."""
    return _elementwise(_angles, float, z)


def polar(size: ArrayLike, angle: ArrayLike) -> NDArray[np.complex128]:
    """Numbers r e^(j phi) of magnitudes and angles, rad."""
    return _elementwise(_turned, complex, size, angle, of=float)


def exponentials(z: ArrayLike) -> NDArray[np.complex128]:
    """Exponentials e^z."""
    return _elementwise(_exponentials, complex, z)


@compiled
def power(z: complex, n: int) -> complex:
    """The n-th power of z, n >= 0, by squares."""
    found, square = complex(1.0, 0.0), z
    while n > 0:
        if n % 2 == 1:
            found = found * square
        square = square * square
        n //= 2
    return found


@compiled
def line_factors(w: complex) -> tuple[complex, complex]:
    """Factors sinh(g) / g and tanh(g / 2) / (g / 2) at w = g^2, by the series of sinh and cosh in w and w / 4."""
    whole = half = even = complex(1.0, 0.0)  # sinh(g) / g, sinh(g / 2) / (g / 2), cosh(g / 2)
    term = half_term = even_term = complex(1.0, 0.0)
    k = 0
    while abs(term.real) + abs(term.imag) > SERIES * (abs(whole.real) + abs(whole.imag)):
        k += 1
        term = term * w / ((2.0 * k) * (2.0 * k + 1.0))
        half_term = half_term * w / (4.0 * (2.0 * k) * (2.0 * k + 1.0))
        even_term = even_term * w / (4.0 * (2.0 * k) * (2.0 * k - 1.0))
        whole, half, even = whole + term, half + half_term, even + even_term
    return whole, half / even
