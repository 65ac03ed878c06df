"""Membership functions with their derivatives; compiled.

Each takes a membership's parameters `theta` and an input x; it returns the degree of membership in [0, 1] and its
derivative with respect to x, and writes the derivatives with respect to `theta` to `slope`. Sources: (3.9), (3.10),
(3.11). The derivatives (4.6) to (4.9) of the output follow by the chain rule ((4.9) has an extra factor 2).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from facts_damping.compiling import compiled
from facts_damping.elementary import exp

if TYPE_CHECKING:
    from facts_damping.compiling.structs import Float1


POINTS = 9  # control points of a B-spline, on [-1, 1]


@compiled
def gaussian(theta: Float1, x: float, slope: Float1) -> tuple[float, float]:
    """exp(-((x - h) / s)^2), (3.9); theta = h, s."""
    h, s = theta[0], theta[1]
    z = (x - h) / s
    value = exp(-z * z)
    slope[0] = value * 2.0 * z / s
    slope[1] = value * 2.0 * z * z / s
    return value, -slope[0]


@compiled
def triangular(theta: Float1, x: float, slope: Float1) -> tuple[float, float]:
    """max(0, 1 - 2 |x - h| / s), (3.10); theta = h, s."""
    h, s = theta[0], theta[1]
    value = 1.0 - 2.0 * abs(x - h) / s
    if value <= 0.0:
        slope[0] = slope[1] = 0.0
        return 0.0, 0.0
    slope[0] = math.copysign(2.0 / s, x - h)
    slope[1] = (1.0 - value) / s
    return value, -slope[0]


@compiled
def nearest_point(theta: Float1, x: float, slope: Float1) -> tuple[float, float]:
    """Degree of a B-spline's nearest control point, (3.11), figure 3.4; inputs are clipped to [-1, 1]."""
    return _spline(True, theta, x, slope)


@compiled
def spline(theta: Float1, x: float, slope: Float1) -> tuple[float, float]:
    """B-spline of order 2 through its control points, (3.11); inputs are clipped to [-1, 1]."""
    return _spline(False, theta, x, slope)


@compiled
def _spline(nearest: bool, theta: Float1, x: float, slope: Float1) -> tuple[float, float]:
    """Order-2 B-spline over equally spaced control points: their degrees, weighted by the basis (3.12).

    `nearest`: returns the nearest control point's degree, the lower index in ties; the thesis calls it the data point.
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
    fraction = place - at
    slope[at], slope[at + 1] = 1.0 - fraction, fraction
    rise = theta[at + 1] - theta[at]
    return theta[at] + fraction * rise, (rise * 0.5 * (POINTS - 1) if inside else 0.0)
