"""Membership functions with their derivatives; compiled, branching on the kind's code."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled, inner
from facts_damping.neurofuzzy.table import GAUSSIAN, POINTS, SPLINE_NEAREST, TRIANGULAR

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@compiled
def membership(kind: int, theta: NDArray[np.float64], x: float, slope: NDArray[np.float64]) -> tuple[float, float]:
    """Degree of membership in [0, 1] and its derivative by the input; its derivatives by `theta` into `slope`.

    Inputs of B-splines are clipped to [-1, 1], where their control points lie. Sources: (3.9), (3.10), (3.11); the
    derivatives (4.6) to (4.9) of the output follow from these by the chain rule ((4.9) has a factor 2 too many).
    """
    if kind == GAUSSIAN:
        h, s = theta[0], theta[1]
        z = (x - h) / s
        value = math.exp(-z * z)
        slope[0] = value * 2.0 * z / s
        slope[1] = value * 2.0 * z * z / s
        return value, -slope[0]
    if kind == TRIANGULAR:
        h, s = theta[0], theta[1]
        value = 1.0 - 2.0 * abs(x - h) / s
        if value <= 0.0:
            slope[0] = slope[1] = 0.0
            return 0.0, 0.0
        slope[0] = math.copysign(2.0 / s, x - h)
        slope[1] = (1.0 - value) / s
        return value, -slope[0]
    return _spline(kind == SPLINE_NEAREST, theta, x, slope)


@inner
def _spline(nearest: bool, theta: NDArray[np.float64], x: float, slope: NDArray[np.float64]) -> tuple[float, float]:
    """Order-2 B-spline over equally spaced control points: their degrees, weighted by the basis (3.12).

    `nearest` takes the nearest control point's degree, ties to the lower index: the thesis's data point.
    """
    for i in range(POINTS):
        slope[i] = 0.0
    inside = -1.0 <= x <= 1.0
    place = (min(max(x, -1.0), 1.0) + 1.0) * 0.5 * (POINTS - 1)
    if nearest:
        at = min(math.ceil(place - 0.5), POINTS - 1)
        slope[at] = 1.0
        return theta[at], 0.0
    at = min(int(place), POINTS - 2)
    share = place - at
    slope[at], slope[at + 1] = 1.0 - share, share
    rise = theta[at + 1] - theta[at]
    return theta[at] + share * rise, (rise * 0.5 * (POINTS - 1) if inside else 0.0)
