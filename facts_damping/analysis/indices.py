"""Performance indices (4.108)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Exponents (r, s) of time and deviation.
INDICES = {"ITAE": (1, 1), "IAE": (0, 1), "ITSE": (1, 2), "ISE": (0, 2)}


def performance_indices(
    time_s: NDArray[np.float64], deviations: NDArray[np.float64], since: float = 0.0
) -> dict[str, float]:
    """Indices `int_0^T t^r sum_i |dw_i|^s dt` by the trapezoidal rule on the recorded frames.

    `time_s`: (ticks,), s; `deviations`: (ticks, n), local and interarea speed differences, p.u.;
    `since`: s, the instant that counts as t = 0 and before which nothing counts (the first event's, say;
    the integral begins with the first frame not before it). Returns ITAE (p.u. s^2), IAE (p.u. s),
    ITSE (p.u.^2 s^2), ISE (p.u.^2 s). Source: (4.108), with r and s as there.
    """
    kept = time_s >= since
    t = time_s[kept] - since
    magnitude = np.abs(np.reshape(deviations, (len(time_s), -1))[kept])
    return {name: _trapezoid(t, t**r * np.sum(magnitude**s, axis=1)) for name, (r, s) in INDICES.items()}


def _trapezoid(t: NDArray[np.float64], f: NDArray[np.float64]) -> float:
    """Integral of f(t); np.trapezoid is missing in NumPy 1, np.trapz in later ones."""
    return float(np.sum(np.diff(t) * (f[1:] + f[:-1])) / 2)
