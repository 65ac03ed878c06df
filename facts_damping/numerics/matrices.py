"""Linear algebra with the same bits on all processors, for initial states and controller design.

BLAS, used by NumPy and SciPy for products and solutions, has different kernels for different processors, which sum in
different orders. Here the order of summation is fixed by the code. Matrices are small, and the methods need only
products and solutions:

- the exponential by scaling and squaring of Taylor's series (N. J. Higham, Functions of Matrices, 2008, 10);
- the sign of a matrix and Lyapunov's equation by Newton's iteration (J. D. Roberts, Linear Model Reduction and Solution
  of the Algebraic Riccati Equation by Use of the Sign Function, Int. J. Control 32(4), 1980);
- Riccati's equation by doubling (E. K.-W. Chu, H.-Y. Fan, W.-W. Lin, C.-S. Wang, Structure-Preserving Algorithms for
  Periodic Discrete-Time Algebraic Riccati Equations, Int. J. Control 77(8), 2004);
- singular values by rotations of pairs of columns (J. Demmel, K. Veselic, Jacobi's Method is More Accurate than QR,
  SIAM J. Matrix Anal. Appl. 13(4), 1992);
- an eigenvalue near an approximate one by inverse iteration.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from facts_damping.compiling import compiled, entry_point
from facts_damping.compiling.structs import Complex1, Complex2, Float1, Float2
from facts_damping.numerics.phasors import magnitudes, over

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    Pair = tuple[NDArray[np.float64], NDArray[np.float64]]

TERMS = 16  # terms of Taylor's series; the next is below 1e-19 for a norm of 1/2
MAXIMUM = 100  # steps of an iteration, which otherwise does not converge
NEAR = 1e-9  # of the largest entry: convergence is quadratic, so after such a step no error is left
ALIKE = 1e-15  # cosine of the angle between two columns that counts as a right angle
GRID = 1e-5  # 1/s: eigenvalues of two kernels differ by far less, those of two modes by far more
STEPS = 6  # of inverse iteration; each reduces the error by GRID over the distance to the next mode


@compiled
def _multiply(a: NDArray[Any], b: NDArray[Any], out: NDArray[Any]) -> None:
    """Add the product of two matrices to `out`."""
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]


@compiled
def size_of_pivot(z: Any) -> float:
    """|Re z| + |Im z|, the criterion for pivots: unlike the magnitude it needs no rounded root."""
    return abs(z.real) + abs(z.imag)  # type: ignore[no-any-return]


@compiled
def eliminate(a: NDArray[Any]) -> bool:
    """Solve a[:, :n] x = a[:, n:] by Gaussian elimination with pivoting; x replaces a[:, n:]. False if singular."""
    n, width = a.shape
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if size_of_pivot(a[i, k]) > size_of_pivot(a[pivot, k]):
                pivot = i
        if not size_of_pivot(a[pivot, k]) > 0.0:
            return False
        if pivot != k:
            for j in range(k, width):
                a[k, j], a[pivot, j] = a[pivot, j], a[k, j]
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            if factor != 0.0:
                for j in range(k + 1, width):
                    a[i, j] -= factor * a[k, j]
    for k in range(n - 1, -1, -1):
        for j in range(n, width):
            total = a[k, j]
            for i in range(k + 1, n):
                total -= a[k, i] * a[i, j]
            a[k, j] = total / a[k, k]
    return True


@entry_point
def _rotate(u: Float2, v: Float2) -> None:
    """Rotate the rows of `u` in pairs until all are orthogonal, and apply the same rotations to `v`."""
    for _ in range(MAXIMUM):
        turned = False
        for p in range(u.shape[0]):
            for q in range(p + 1, u.shape[0]):
                first = second = both = 0.0
                for i in range(u.shape[1]):
                    first += u[p, i] * u[p, i]
                    second += u[q, i] * u[q, i]
                    both += u[p, i] * u[q, i]
                if abs(both) <= ALIKE * math.sqrt(first) * math.sqrt(second):
                    continue
                turned = True
                slope = (second - first) / (2.0 * both)
                tangent = math.copysign(1.0, slope) / (abs(slope) + math.sqrt(1.0 + slope * slope))
                cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
                sine = cosine * tangent
                for i in range(u.shape[1]):
                    u[p, i], u[q, i] = cosine * u[p, i] - sine * u[q, i], sine * u[p, i] + cosine * u[q, i]
                for i in range(v.shape[1]):
                    v[p, i], v[q, i] = cosine * v[p, i] - sine * v[q, i], sine * v[p, i] + cosine * v[q, i]
        if not turned:
            return


@entry_point
def _multiply_real(a: Float2, b: Float2, out: Float2) -> None:
    _multiply(a, b, out)


@entry_point
def _multiply_complex(a: Complex2, b: Complex2, out: Complex2) -> None:
    _multiply(a, b, out)


@entry_point
def _eliminate_real(a: Float2) -> bool:
    return eliminate(a)


@entry_point
def _eliminate_complex(a: Complex2) -> bool:
    return eliminate(a)


def _plain(values: NDArray[Any], kind: Any) -> NDArray[Any]:
    """A copy of a matrix, or of a vector as a one-column matrix, for compiled functions."""
    return np.array(values if values.ndim == 2 else values[:, None], kind, order="C")


def product(first: NDArray[Any], *others: NDArray[Any]) -> NDArray[Any]:
    """Product of matrices and vectors from left to right, as `first @ second @ ...`."""
    for other in others:
        kind = np.result_type(first, other)
        out = np.zeros((1 if first.ndim == 1 else len(first), 1 if other.ndim == 1 else other.shape[1]), kind)
        multiply = _multiply_complex if kind == np.complex128 else _multiply_real
        multiply(_plain(np.atleast_2d(first), kind), _plain(other, kind), out)
        first = out.reshape(first.shape[:-1] + other.shape[1:])
    return first


def solve(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    """Solution x of a x = b for a vector or matrix b. Raises `LinAlgError` if a is singular."""
    kind, n = np.result_type(a, b, float), len(a)
    both = np.ascontiguousarray(np.column_stack([a, b]), kind)
    if not (_eliminate_complex if kind == np.complex128 else _eliminate_real)(both):
        raise np.linalg.LinAlgError("singular matrix")
    return both[:, n:].reshape(b.shape)


def exponential(a: Float2) -> Float2:
    """exp(a) by Taylor's series of a / 2^s, squared s times."""
    norm = np.abs(a).sum(axis=1).max(initial=0.0)
    halved = max(0, math.frexp(norm)[1] + 1)
    identity, small = np.eye(len(a)), a / math.ldexp(1.0, halved)
    series = identity
    for k in range(TERMS, 0, -1):
        series = identity + product(small, series) / k
    for _ in range(halved):
        series = product(series, series)
    return series


def _divided(a: Float2, q: Float2) -> Pair:
    """Limits of a <- (a + a^-1) / 2 and q <- (q + a^-1 q a^-T) / 2: the sign of a, and twice `lyapunov`."""
    identity = np.eye(len(a))
    for _ in range(MAXIMUM):
        inverse = solve(a, identity)
        before, a = a, (a + inverse) / 2.0
        q = (q + product(inverse, q, inverse.T)) / 2.0
        if np.abs(a - before).max(initial=0.0) <= NEAR * np.abs(a).max(initial=0.0):
            return a, q
    raise np.linalg.LinAlgError("an eigenvalue on the imaginary axis")


def sign(a: Float2) -> Float2:
    """The matrix with the eigenvectors of a, and the signs of the real parts of its eigenvalues as eigenvalues."""
    return _divided(a, np.zeros_like(a))[0]


def lyapunov(a: Float2, q: Float2) -> Float2:
    """Solution x of a x + x a^T + q = 0 for a stable a."""
    return _divided(a, q)[1] / 2.0


def riccati(a: Float2, b: Float2, q: Float2, r: Float2) -> Float2:
    """Stabilising solution x of x = a^T x a - a^T x b (r + b^T x b)^-1 b^T x a + q; q and r symmetric.

    After k steps x is the minimum cost over 2^k frames, and a the closed-loop transition over them. Raises
    `LinAlgError` if there is none: a mode that does not decay is uncontrollable by b or has no cost.
    """
    n, identity, x, g = len(a), np.eye(len(a)), q, product(b, solve(r, b.T))
    for _ in range(MAXIMUM):
        both = solve(identity + product(g, x), np.hstack([a, g]))
        g = g + product(a, both[:, n:], a.T)
        x = x + product(a.T, x, both[:, :n])
        a = product(a, both[:, :n])
        g, x = (g + g.T) / 2.0, (x + x.T) / 2.0
        if np.abs(a).max(initial=0.0) <= NEAR:
            return np.asarray(x)
        if not (np.isfinite(a).all() and np.isfinite(x).all() and np.isfinite(g).all()):
            break
    raise np.linalg.LinAlgError("Riccati's equation has no stabilising solution")


def singular(a: Float2) -> tuple[Float2, Float1, Float2]:
    """U, s and V of a = U diag(s) V^T, s descending; columns of U are zero where s is."""
    u, v = _plain(a.T, float), np.eye(a.shape[1])
    _rotate(u, v)
    s = np.sqrt((u * u).sum(axis=1))
    order = np.argsort(-s, kind="stable")
    u, s, v = u[order], s[order], v[order]
    return (u / np.where(s > 0.0, s, 1.0)[:, None]).T, s, v.T


def least_squares(a: Float2, b: Float1) -> Float1:
    """Minimum-norm vector x that minimises |a x - b|; singular values at round-off level are dropped."""
    u, s, v = singular(a)
    significant = s > np.finfo(float).eps * max(a.shape) * s.max(initial=0.0)
    return product(v[:, significant], product(u[:, significant].T, b) / s[significant])


def shift_near(guess: complex) -> complex:
    """The same shift near an eigenvalue on all processors, 1/s.

    The guess may come from LAPACK: it is rounded to GRID, where all kernels agree. The shift lies a third of the grid
    beside that point, because a shift equal to an eigenvalue gives a singular matrix.
    """
    return (complex(round(guess.real / GRID), round(guess.imag / GRID)) + 1 / 3) * GRID


def eigenvalue_near(a: Float2, guess: complex) -> tuple[complex, Complex1, Complex1]:
    """The eigenvalue (1/s) nearest a guess, v of a v = lambda v and w of w a = lambda w, their largest entries 1.

    The initial vector is not symmetric, because a symmetric one has no component along half of the modes of symmetric
    plants.
    """
    shifted = a - shift_near(guess) * np.eye(len(a))
    right = left = np.array(1.0 / np.arange(1.0, len(a) + 1), np.complex128)
    for _ in range(STEPS):
        right, left = (over(v, v[np.argmax(magnitudes(v))]) for v in (solve(shifted, right), solve(shifted.T, left)))
    return complex(over(product(left, a, right), product(left, right))), right, left


def root(gramian: Float2) -> Float2:
    """S of S S^T = P for a symmetric positive semidefinite P."""
    axes, values, _ = singular((gramian + gramian.T) / 2.0)
    return axes * np.sqrt(values)


def parts(n: int, links: Iterable[tuple[int, int]]) -> list[int]:
    """Index of the connected component of each of n elements, in order of appearance; `links`: pairs of elements."""
    near: list[list[int]] = [[] for _ in range(n)]
    for a, b in links:
        near[a].append(b)
        near[b].append(a)
    label, count = [-1] * n, 0
    for first in range(n):
        if label[first] >= 0:
            continue
        label[first], waiting = count, [first]
        while waiting:
            for other in near[waiting.pop()]:
                if label[other] < 0:
                    label[other] = count
                    waiting.append(other)
        count += 1
    return label
