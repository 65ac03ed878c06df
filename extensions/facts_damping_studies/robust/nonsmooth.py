"""Minimisation of a function with kinks: BFGS with a weak Wolfe line search, then gradient sampling.

BFGS with this search converges on functions that are not smooth at their minimum, as worst cases are; where it stalls,
the shortest vector in the hull of gradients sampled nearby is the direction of descent, in a ball that shrinks (A. S.
Lewis, M. L. Overton, Nonsmooth Optimization via Quasi-Newton Methods, Mathematical Programming 141, 2013; J. V. Burke,
A. S. Lewis, M. L. Overton, A Robust Gradient Sampling Algorithm for Nonsmooth, Nonconvex Optimization, SIAM J.
Optimization 15(3), 2005; both as in HANSO, which is not used).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import nnls

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Function = Callable[[Array], tuple[float, Array]]

ARMIJO, WOLFE = 1e-4, 0.5  # of the line search
HALVINGS = 30  # of a step, at most
STILL = 1e-5  # relative decrease below which an iteration counts as a stall
STALLS = 5  # in turn, that end BFGS
RADII = 0.1, 0.01  # of gradient sampling, relative to the point's size


class Minimum(NamedTuple):
    """Where a function was least, its value there, and how often it was evaluated."""

    at: Array
    value: float
    evaluations: int


class _Counted:
    def __init__(self, function: Function, progress: Callable[[int], None]) -> None:
        self.function, self.progress, self.evaluations = function, progress, 0

    def __call__(self, x: Array) -> tuple[float, Array]:
        self.evaluations += 1
        self.progress(self.evaluations)
        return self.function(x)


def minimum(
    function: Function, start: Array, most: int, random: np.random.Generator, progress: Callable[[int], None]
) -> Minimum:
    """The least value found from a start with at most some evaluations; values may be infinite elsewhere."""
    counted = _Counted(function, progress)
    x, f = _bfgs(counted, start, most * 3 // 4)
    x, f = _sampled(counted, x, f, most, random)
    return Minimum(x, f, counted.evaluations)


def _bfgs(function: _Counted, x: Array, most: int) -> tuple[Array, float]:
    f, g = function(x)
    H, stalls = np.eye(len(x)) / max(1.0, float(np.linalg.norm(g))), 0
    while function.evaluations < most and stalls < STALLS and np.isfinite(f):
        p = -H @ g
        if p @ g >= 0.0:
            H, p = np.eye(len(x)), -g
        step, f_new, g_new = _search(function, x, f, g, p, most)
        if step == 0.0:
            break
        s, y = step * p, g_new - g
        stalls = stalls + 1 if f - f_new < STILL * max(1.0, abs(f)) else 0
        x, f, g = x + s, f_new, g_new
        if s @ y > 1e-12 * np.linalg.norm(s) * np.linalg.norm(y):
            rho, eye = 1.0 / (s @ y), np.eye(len(x))
            H = (eye - rho * np.outer(s, y)) @ H @ (eye - rho * np.outer(y, s)) + rho * np.outer(s, s)
    return x, f


def _search(function: _Counted, x: Array, f: float, g: Array, p: Array, most: int) -> tuple[float, float, Array]:
    """A step by bisection with the weak Wolfe conditions, or the best with the first of them; 0: none."""
    low, high, step = 0.0, np.inf, 1.0
    best = (0.0, f, g)
    for _ in range(HALVINGS):
        if function.evaluations >= most:
            break
        value, gradient = function(x + step * p)
        if not value <= f + ARMIJO * step * float(g @ p):
            high = step
        else:
            best = (step, value, gradient)
            if gradient @ p >= WOLFE * (g @ p):
                break
            low = step
        step = 2.0 * low if np.isinf(high) else 0.5 * (low + high)
    return best


def _sampled(function: _Counted, x: Array, f: float, most: int, random: np.random.Generator) -> tuple[Array, float]:
    """Gradient sampling from a point."""
    samples = min(2 * len(x), 20)
    for relative in RADII:
        radius = relative * max(1.0, float(np.abs(x).max())) / np.sqrt(len(x))
        while np.isfinite(f) and function.evaluations + samples < most:
            gradients = [function(x)[1]]
            for _ in range(samples):
                value, gradient = function(x + radius * random.uniform(-1.0, 1.0, len(x)))
                if np.isfinite(value):
                    gradients.append(gradient)
            steepest = shortest(np.array(gradients))
            if not np.linalg.norm(steepest) > 0.0:
                break
            p = -steepest / float(np.linalg.norm(steepest)) * radius * 10.0
            step, value, _ = _search(function, x, f, steepest, p, most)
            if step == 0.0 or f - value < STILL * max(1.0, abs(f)):
                break
            x, f = x + step * p, value
    return x, f


def shortest(gradients: Array) -> Array:
    """The shortest vector of the convex hull of rows (P. Wolfe 1976, here by non-negative least squares)."""
    scale = max(1e-300, float(np.abs(gradients).max()))
    big = 1e3
    rows = np.vstack([gradients.T / scale, np.full((1, len(gradients)), big)])
    weights, _ = nnls(rows, np.r_[np.zeros(gradients.shape[1]), big])
    total = weights.sum()
    vector: Array = (weights / total if total > 0.0 else np.full(len(gradients), 1.0 / len(gradients))) @ gradients
    return vector
