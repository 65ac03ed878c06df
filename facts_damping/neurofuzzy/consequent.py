"""Consequents of a rule with their derivatives; compiled, branching on the kind's code."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.neurofuzzy.table import (
    AFFINE,
    DEGREES,
    FOURIER,
    HARMONICS,
    LEGENDRE,
    MEXICAN_HAT,
    MORLET,
    SAM,
    SINGLETON,
    WAVELETS,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@compiled
def consequent(
    kind: int,
    theta: NDArray[np.float64],
    x: NDArray[np.float64],
    firing: float,
    slope: NDArray[np.float64],
    by_input: NDArray[np.float64],
) -> tuple[float, float, float]:
    """Consequent zeta of a rule and output, its weight beside the firing strength, its derivative by that strength.

    Derivatives of zeta by `theta` go into `slope` (for `sam` that by the volume is left zero), by the inputs into
    `by_input`. Sources: control laws (3.13) to (3.30), (6.4); the derivatives are checked by differences.
    """
    by_input[:] = 0.0
    if kind == SINGLETON:
        slope[0] = 1.0
        return theta[0], 1.0, 0.0
    if kind == AFFINE:
        slope[0], value = 1.0, theta[0]
        for i in range(x.size):
            slope[1 + i], by_input[i] = x[i], theta[1 + i]
            value += theta[1 + i] * x[i]
        return value, 1.0, 0.0
    if kind == SAM:
        slope[0], slope[1] = 1.0, 0.0
        return theta[0], theta[1], 0.0
    if kind == FOURIER:
        return _fourier(theta, x, slope, by_input), 1.0, 0.0
    if kind in (MEXICAN_HAT, MORLET):
        return _wavelets(kind, theta, x, slope, by_input), 1.0, 0.0
    if kind == LEGENDRE:
        return _legendre(theta, x, slope, by_input), 1.0, 0.0
    value, by_firing = _legendre_wavelets(theta, firing, slope)
    return value, 1.0, by_firing


@compiled
def _harmonic(d: int, x: float) -> tuple[float, float]:
    """1, sin x, cos x, sin 2x, cos 2x and their derivatives."""
    if d == 0:
        return 1.0, 0.0
    n = (d + 1) // 2
    if d % 2 == 1:
        return math.sin(n * x), n * math.cos(n * x)
    return math.cos(n * x), -n * math.sin(n * x)


@compiled
def _fourier(
    theta: NDArray[np.float64], x: NDArray[np.float64], slope: NDArray[np.float64], by_input: NDArray[np.float64]
) -> float:
    """W . kron_i [1, sin x_i, cos x_i, sin 2 x_i, cos 2 x_i]."""
    value = 0.0
    for term in range(theta.size):
        product, rest = 1.0, term
        for i in range(x.size - 1, -1, -1):
            product *= _harmonic(rest % HARMONICS, x[i])[0]
            rest //= HARMONICS
        slope[term] = product
        value += theta[term] * product
        for k in range(x.size):
            product, rest = theta[term], term
            for i in range(x.size - 1, -1, -1):
                of_x, by_x = _harmonic(rest % HARMONICS, x[i])
                product *= by_x if i == k else of_x
                rest //= HARMONICS
            by_input[k] += product
    return value


@compiled
def _wavelets(
    kind: int,
    theta: NDArray[np.float64],
    x: NDArray[np.float64],
    slope: NDArray[np.float64],
    by_input: NDArray[np.float64],
) -> float:
    """W sum_i psi(q_i), q = (x - tau) / nu: Mexican hat |nu|^-0.5 (1 - q^2) exp(-q^2/2), Morlet exp(-q^2/2) cos 5q."""
    w, total = theta[0], 0.0
    for i in range(x.size):
        tau, nu = theta[1 + 2 * i], theta[2 + 2 * i]
        q = (x[i] - tau) / nu
        bell = math.exp(-0.5 * q * q)
        if kind == MORLET:
            psi = bell * math.cos(5.0 * q)
            by_q = -bell * (q * math.cos(5.0 * q) + 5.0 * math.sin(5.0 * q))
            own = 0.0
        else:
            scale = 1.0 / math.sqrt(abs(nu))
            psi = scale * (1.0 - q * q) * bell
            by_q = scale * (q * q * q - 3.0 * q) * bell
            own = -0.5 * psi / nu
        total += psi
        slope[1 + 2 * i] = -w * by_q / nu
        slope[2 + 2 * i] = w * (own - by_q * q / nu)
        by_input[i] = w * by_q / nu
    slope[0] = total
    return w * total  # type: ignore[no-any-return]


@compiled
def legendre(d: int, x: float) -> tuple[float, float]:
    """Legendre polynomial of degree 0 to 3, and its derivative."""
    if d == 0:
        return 1.0, 0.0
    if d == 1:
        return x, 1.0
    if d == 2:
        return 1.5 * x * x - 0.5, 3.0 * x
    return 2.5 * x * x * x - 1.5 * x, 7.5 * x * x - 1.5


@compiled
def _legendre(
    theta: NDArray[np.float64], x: NDArray[np.float64], slope: NDArray[np.float64], by_input: NDArray[np.float64]
) -> float:
    """tanh(sum_id w_id L_d(x_i)), inputs clipped to [-1, 1]."""
    xi = 0.0
    for i in range(x.size):
        at = min(max(x[i], -1.0), 1.0)
        inside = 1.0 if at == x[i] else 0.0
        for d in range(DEGREES):
            of_x, by_x = legendre(d, at)
            slope[DEGREES * i + d] = of_x
            by_input[i] += inside * theta[DEGREES * i + d] * by_x
            xi += theta[DEGREES * i + d] * of_x
    value = math.tanh(xi)
    damp = 1.0 - value * value
    for k in range(theta.size):
        slope[k] *= damp
    for i in range(x.size):
        by_input[i] *= damp
    return value


@compiled
def basis(term: int, firing: float) -> tuple[float, float]:
    """Orthonormal Legendre wavelet phi_db on [0, 1] and its derivative; term = 2 d + b, the last half closed at 1.

    sqrt(2) sqrt(2 d + 1) L_d(4 F - 2 b - 1) for F in the half b, else zero (3.22, made orthonormal).
    """
    d, b = term // 2, term % 2
    half = 0 if firing < 0.5 else 1
    if half != b:
        return 0.0, 0.0
    scale = math.sqrt(2.0 * (2.0 * d + 1.0))
    value, slope = legendre(d, 4.0 * firing - 2.0 * b - 1.0)
    return scale * value, scale * 4.0 * slope


@compiled
def _legendre_wavelets(theta: NDArray[np.float64], firing: float, slope: NDArray[np.float64]) -> tuple[float, float]:
    """sum_db rho_db phi_db(F), and its derivative by the rule's firing strength F."""
    value = by_firing = 0.0
    for term in range(WAVELETS):
        phi, by_f = basis(term, firing)
        slope[term] = phi
        value += theta[term] * phi
        by_firing += theta[term] * by_f
    return value, by_firing
