"""Consequents of rules with their derivatives; compiled.

Each takes its parameters `theta`, the inputs, the rule's firing strength and `terms`; it returns the consequent zeta of
a rule and output, its volume V, and its derivative with respect to the firing strength. Derivatives of zeta with
respect to `theta` go to `slope`, those with respect to the inputs to `by_input`; for `fourier`, `fourier_terms` and
`fourier_by_input` compute them. Sources: control laws (3.13) to (3.30), (6.4); the derivatives are checked by
differences.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary import cos, exp, sin, tanh

HARMONICS = 5  # 1, sin x, cos x, sin 2x, cos 2x
DEGREES = 4  # degrees of the Legendre polynomials: 0 to 3
WAVELETS = 6  # degrees 0 to 2 on two halves of [0, 1]
LONG = 64  # least length of a sum that is split into partial sums

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1, Float2, Float3


@compiled
def singleton(
    theta: Float1, _x: Float1, _firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """Constant W."""
    by_input[:] = 0.0
    slope[0] = 1.0
    return theta[0], 1.0, 0.0


@compiled
def affine(
    theta: Float1, x: Float1, _firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """w_0 + sum_i w_i x_i, (6.4)."""
    by_input[:] = 0.0
    slope[0], value = 1.0, theta[0]
    for i in range(x.size):
        slope[1 + i], by_input[i] = x[i], theta[1 + i]
        value += theta[1 + i] * x[i]
    return value, 1.0, 0.0


@compiled
def sam(
    theta: Float1, _x: Float1, _firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """Centroid c with volume V, (3.30); the derivative with respect to the volume stays zero."""
    by_input[:] = 0.0
    slope[0], slope[1] = 1.0, 0.0
    return theta[0], theta[1], 0.0


@compiled
def fourier(
    theta: Float1, _x: Float1, _firing: float, terms: Float1, _slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """W . kron_i [1, sin x, cos x, sin 2x, cos 2x], (3.13); its derivatives with respect to `theta` are `terms`."""
    by_input[:] = 0.0
    return dot(0.0, theta, terms), 1.0, 0.0


@compiled
def mexican_hat(
    theta: Float1, x: Float1, _firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """W sum_i psi((x_i - tau_i) / nu_i), (3.14), (3.18)."""
    by_input[:] = 0.0
    return _wavelets(False, theta, x, slope, by_input), 1.0, 0.0


@compiled
def morlet(
    theta: Float1, x: Float1, _firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """W sum_i exp(-q_i^2 / 2) cos 5 q_i, (3.19)."""
    by_input[:] = 0.0
    return _wavelets(True, theta, x, slope, by_input), 1.0, 0.0


@compiled
def harmonics(x: float, wave: Float2) -> None:
    """Write 1, sin x, cos x, sin 2x, cos 2x and their derivatives to the rows of `wave`."""
    sine, cosine = sin(x), cos(x)
    twice, square = 2.0 * sine * cosine, cosine * cosine - sine * sine
    wave[0, 0], wave[0, 1] = 1.0, 0.0
    wave[1, 0], wave[1, 1] = sine, cosine
    wave[2, 0], wave[2, 1] = cosine, -sine
    wave[3, 0], wave[3, 1] = twice, 2.0 * square
    wave[4, 0], wave[4, 1] = square, -2.0 * twice


@compiled
def dot(start: float, a: Float1, b: Float1) -> float:
    """`start` + a . b, in four independent partial sums if it is long, for speed."""
    second = third = fourth = 0.0
    whole = a.size // 4 * 4 if a.size >= LONG else 0
    for i in range(0, whole, 4):
        start += a[i] * b[i]
        second += a[i + 1] * b[i + 1]
        third += a[i + 2] * b[i + 2]
        fourth += a[i + 3] * b[i + 3]
    for i in range(whole, a.size):
        start += a[i] * b[i]
    return (start + second) + (third + fourth)


@compiled
def fourier_terms(waves: Float3, terms: Float1) -> None:
    """kron_i [1, sin x_i, cos x_i, sin 2 x_i, cos 2 x_i] of the inputs' harmonics, (5 ** inputs,)."""
    terms[0] = 1.0
    size = 1
    for i in range(waves.shape[0] - 1, -1, -1):
        for h in range(HARMONICS - 1, -1, -1):
            for t in range(size):
                terms[h * size + t] = terms[t] * waves[i, h, 0]
        size *= HARMONICS


@compiled
def fourier_by_input(theta: Float1, waves: Float3, by_input: Float1) -> None:
    """Derivatives of W . kron_i [...] with respect to the inputs."""
    inputs = waves.shape[0]
    by_input[:] = 0.0
    for term in range(theta.size):
        for k in range(inputs):
            product, rest = theta[term], term
            for i in range(inputs - 1, -1, -1):
                product *= waves[i, rest % HARMONICS, 1 if i == k else 0]
                rest //= HARMONICS
            by_input[k] += product


@compiled
def _wavelets(is_morlet: bool, theta: Float1, x: Float1, slope: Float1, by_input: Float1) -> float:
    """W sum_i psi(q_i), q = (x - tau) / nu: Mexican hat |nu|^-0.5 (1 - q^2) exp(-q^2/2), Morlet exp(-q^2/2) cos 5q."""
    w, total = theta[0], 0.0
    for i in range(x.size):
        tau, nu = theta[1 + 2 * i], theta[2 + 2 * i]
        q = (x[i] - tau) / nu
        bell = exp(-0.5 * q * q)
        if is_morlet:
            psi = bell * cos(5.0 * q)
            by_q = -bell * (q * cos(5.0 * q) + 5.0 * sin(5.0 * q))
            by_nu = 0.0
        else:
            scale = 1.0 / math.sqrt(abs(nu))
            psi = scale * (1.0 - q * q) * bell
            by_q = scale * (q * q * q - 3.0 * q) * bell
            by_nu = -0.5 * psi / nu
        total += psi
        slope[1 + 2 * i] = -w * by_q / nu
        slope[2 + 2 * i] = w * (by_nu - by_q * q / nu)
        by_input[i] = w * by_q / nu
    slope[0] = total
    return w * total  # type: ignore[no-any-return]


@compiled
def polynomial(d: int, x: float) -> tuple[float, float]:
    """Legendre polynomial of degree 0 to 3, and its derivative."""
    if d == 0:
        return 1.0, 0.0
    if d == 1:
        return x, 1.0
    if d == 2:
        return 1.5 * x * x - 0.5, 3.0 * x
    return 2.5 * x * x * x - 1.5 * x, 7.5 * x * x - 1.5


@compiled
def legendre(
    theta: Float1, x: Float1, _firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """tanh(sum_id w_id L_d(x_i)), (3.21), inputs clipped to [-1, 1]."""
    by_input[:] = 0.0
    xi = 0.0
    for i in range(x.size):
        at = min(max(x[i], -1.0), 1.0)
        inside = 1.0 if at == x[i] else 0.0
        for d in range(DEGREES):
            of_x, by_x = polynomial(d, at)
            slope[DEGREES * i + d] = of_x
            by_input[i] += inside * theta[DEGREES * i + d] * by_x
            xi += theta[DEGREES * i + d] * of_x
    value = tanh(xi)
    damp = 1.0 - value * value
    for k in range(theta.size):
        slope[k] *= damp
    for i in range(x.size):
        by_input[i] *= damp
    return value, 1.0, 0.0


@compiled
def basis(term: int, firing: float) -> tuple[float, float]:
    """Orthonormal Legendre wavelet phi_db on [0, 1] and its derivative; term = 2 d + b; the half b = 1 includes 1.

    sqrt(2) sqrt(2 d + 1) L_d(4 F - 2 b - 1) for F in the half b, else zero (3.22, made orthonormal).
    """
    d, b = term // 2, term % 2
    half = 0 if firing < 0.5 else 1
    if half != b:
        return 0.0, 0.0
    scale = math.sqrt(2.0 * (2.0 * d + 1.0))
    value, slope = polynomial(d, 4.0 * firing - 2.0 * b - 1.0)
    return scale * value, scale * 4.0 * slope


@compiled
def legendre_wavelet(
    theta: Float1, _x: Float1, firing: float, _terms: Float1, slope: Float1, by_input: Float1
) -> tuple[float, float, float]:
    """sum_db rho_db phi_db(F), (3.22), (3.24)."""
    by_input[:] = 0.0
    value = by_firing = 0.0
    for term in range(WAVELETS):
        phi, by_f = basis(term, firing)
        slope[term] = phi
        value += theta[term] * phi
        by_firing += theta[term] * by_f
    return value, 1.0, by_firing
